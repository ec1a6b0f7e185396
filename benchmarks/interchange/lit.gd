# What lit.html draws with three.js, drawn by Godot: res://input.bin and the files of res://job.json,
# normals as colours, one picture a frame and file, to the page's answer().
extends Node

const SHADER = "shader_type spatial; render_mode unshaded, cull_disabled; void fragment() { ALBEDO = NORMAL * 0.5 + 0.5; }"

var view = SubViewport.new()
var camera = Camera3D.new()
var material = ShaderMaterial.new()

func _ready():
	var job = JSON.parse_string(FileAccess.get_file_as_string("res://job.json"))
	material.shader = Shader.new()
	material.shader.code = SHADER
	view.size = Vector2i(job.size, job.size)
	view.own_world_3d = true
	view.transparent_bg = true
	view.render_target_update_mode = SubViewport.UPDATE_ALWAYS
	view.add_child(camera)
	add_child(view)
	var numbers = FileAccess.get_file_as_bytes("res://input.bin").to_float32_array()
	var faces = FileAccess.get_file_as_bytes("res://faces.bin").to_int32_array()
	faces.reverse() # triangles are clockwise here
	var half = numbers.size() / job.frames.size() / 2
	var out = [[]]
	for k in job.frames.size():
		var arrays = []
		arrays.resize(Mesh.ARRAY_MAX)
		arrays[Mesh.ARRAY_VERTEX] = vectors(numbers, 2 * k * half, half)
		arrays[Mesh.ARRAY_NORMAL] = vectors(numbers, (2 * k + 1) * half, half)
		arrays[Mesh.ARRAY_INDEX] = faces
		var item = MeshInstance3D.new()
		item.mesh = ArrayMesh.new()
		item.mesh.add_surface_from_arrays(Mesh.PRIMITIVE_TRIANGLES, arrays)
		item.material_override = material
		view.add_child(item)
		out[0].append(await drawn(job.cameras[k]))
		item.free()
	for file in job.files:
		var state = GLTFState.new()
		var document = GLTFDocument.new()
		document.append_from_buffer(FileAccess.get_file_as_bytes("res://" + file), "", state)
		var scene = document.generate_scene(state, job.fps)
		view.add_child(scene)
		for item in scene.find_children("*", "MeshInstance3D", true, false):
			item.material_override = material
			item.extra_cull_margin = 16384
		var player = scene.find_children("*", "AnimationPlayer", true, false)[0]
		player.play(player.get_animation_list()[0])
		player.pause()
		out.append([])
		for k in job.frames.size():
			player.seek(job.frames[k] / job.fps, true)
			out[-1].append(await drawn(job.cameras[k]))
		scene.free()
	JavaScriptBridge.eval("answer(%s)" % JSON.stringify(JSON.stringify(out)))

func vectors(numbers, start, count):
	var out = PackedVector3Array()
	for k in range(start, start + count, 3):
		out.append(Vector3(numbers[k], numbers[k + 1], numbers[k + 2]))
	return out

func vector(v):
	return Vector3(v[0], v[1], v[2])

func drawn(place):
	camera.fov = place.fov
	camera.near = place.near
	camera.far = place.far
	camera.look_at_from_position(vector(place.eye), vector(place.target))
	await RenderingServer.frame_post_draw
	await RenderingServer.frame_post_draw
	var image = view.get_texture().get_image()
	return "data:image/png;base64," + Marshalls.raw_to_base64(image.save_png_to_buffer())
