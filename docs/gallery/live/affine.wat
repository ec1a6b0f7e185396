(module ;; compiled by wat2wasm of WABT into affine.wasm
  (memory (export "memory") 1)
  ;; out = W x + b: W of `rows` rows of `n` numbers, rows a multiple of 4, n of 4; addresses in bytes
  (func (export "affine") (param $w i32) (param $b i32) (param $x i32) (param $out i32) (param $n i32) (param $rows i32)
    (local $c i32) (local $row i32) (local $end i32) (local $y v128)
    (local $s v128) (local $t v128) (local $u v128) (local $v v128)
    (local.set $row (i32.shl (local.get $n) (i32.const 2)))
    (local.set $end (i32.add (local.get $x) (local.get $row)))
    (block $done
      (loop $rows
        (br_if $done (i32.eqz (local.get $rows)))
        (local.set $s (v128.const i32x4 0 0 0 0))
        (local.set $t (v128.const i32x4 0 0 0 0))
        (local.set $u (v128.const i32x4 0 0 0 0))
        (local.set $v (v128.const i32x4 0 0 0 0))
        (local.set $c (local.get $x))
        (loop $columns
          (local.set $y (v128.load (local.get $c)))
          (local.set $s (f32x4.add (local.get $s) (f32x4.mul (local.get $y) (v128.load (local.get $w)))))
          (local.set $t (f32x4.add (local.get $t) (f32x4.mul (local.get $y) (v128.load (i32.add (local.get $w) (local.get $row))))))
          (local.set $u (f32x4.add (local.get $u) (f32x4.mul (local.get $y) (v128.load (i32.add (local.get $w) (i32.shl (local.get $row) (i32.const 1)))))))
          (local.set $v (f32x4.add (local.get $v) (f32x4.mul (local.get $y) (v128.load (i32.add (local.get $w) (i32.mul (local.get $row) (i32.const 3)))))))
          (local.set $w (i32.add (local.get $w) (i32.const 16)))
          (local.set $c (i32.add (local.get $c) (i32.const 16)))
          (br_if $columns (i32.lt_u (local.get $c) (local.get $end))))
        ;; transpose the four sums by adding halves
        (local.set $y (f32x4.add
          (i8x16.shuffle 0 1 2 3 16 17 18 19 4 5 6 7 20 21 22 23 (local.get $s) (local.get $t))
          (i8x16.shuffle 8 9 10 11 24 25 26 27 12 13 14 15 28 29 30 31 (local.get $s) (local.get $t))))
        (local.set $s (f32x4.add
          (i8x16.shuffle 0 1 2 3 16 17 18 19 4 5 6 7 20 21 22 23 (local.get $u) (local.get $v))
          (i8x16.shuffle 8 9 10 11 24 25 26 27 12 13 14 15 28 29 30 31 (local.get $u) (local.get $v))))
        (v128.store (local.get $out) (f32x4.add (v128.load (local.get $b)) (f32x4.add
          (i8x16.shuffle 0 1 2 3 4 5 6 7 16 17 18 19 20 21 22 23 (local.get $y) (local.get $s))
          (i8x16.shuffle 8 9 10 11 12 13 14 15 24 25 26 27 28 29 30 31 (local.get $y) (local.get $s)))))
        (local.set $w (i32.add (local.get $w) (i32.mul (local.get $row) (i32.const 3))))
        (local.set $b (i32.add (local.get $b) (i32.const 16)))
        (local.set $out (i32.add (local.get $out) (i32.const 16)))
        (local.set $rows (i32.sub (local.get $rows) (i32.const 4)))
        (br $rows)))))
