// Two programs: `SKIN` writes the vertices of model and input into buffers, `DRAW` draws either.

const WIDE = 1024; // texels in a row of a texture of points
const BONES_WIDE = 256; // bones in a row, three texels each

const SKIN_HEAD = `#version 300 es
precision highp float;
precision highp sampler2D;
layout(location = 0) in vec3 rest;
layout(location = 1) in uvec4 bonesA;
layout(location = 2) in uvec4 bonesB;
layout(location = 3) in vec4 weightsA;
layout(location = 4) in vec4 weightsB;
layout(location = 5) in vec3 off;
uniform sampler2D transforms;
uniform float unitOff;
out vec4 model;
out vec4 truth;

void put(vec3 p) {
  vec3 difference = unitOff * off;
  model = vec4(p, length(difference));
  truth = vec4(p + difference, length(difference));
  gl_Position = vec4(0);
}
`;

const SKIN_VERTEX = `${SKIN_HEAD}
vec3 moved(uint bone, float weight) {
  if (weight == 0.0) return vec3(0);
  ivec2 at = ivec2(3u * (bone % ${BONES_WIDE}u), bone / ${BONES_WIDE}u);
  vec4 p = vec4(rest, 1);
  return weight * vec3(
    dot(texelFetch(transforms, at, 0), p),
    dot(texelFetch(transforms, at + ivec2(1, 0), 0), p),
    dot(texelFetch(transforms, at + ivec2(2, 0), 0), p));
}

void main() {
  vec3 p = vec3(0);
  for (int k = 0; k < 4; k++) p += moved(bonesA[k], weightsA[k]);
  for (int k = 0; k < 4; k++) p += moved(bonesB[k], weightsB[k]);
  put(p);
}`;

const SKIN_FRAGMENT = `#version 300 es
void main() {}`;

const DRAW_VERTEX = `#version 300 es
precision highp float;
precision highp sampler2D;
precision highp usampler2D;
layout(location = 0) in uint vertex;
layout(location = 1) in uvec2 fan;
layout(location = 2) in vec2 uv;
layout(location = 3) in vec4 shade;
uniform sampler2D points;
uniform usampler2D ring;
uniform mat4 view;
uniform mat4 projection;
uniform float pointSize;
uniform float behind; // as if it were so much farther, where other surfaces are near
out vec3 normal;
out vec3 place;
out vec2 texel;
out vec3 paint;
out float error;

vec4 point(uint i) {
  return texelFetch(points, ivec2(i % ${WIDE}u, i / ${WIDE}u), 0);
}

void main() {
  vec4 p = point(vertex);
  vec3 sum = vec3(0);
  for (uint k = fan.x; k < fan.x + fan.y; k++) {
    uvec2 pair = texelFetch(ring, ivec2(k % ${WIDE}u, k / ${WIDE}u), 0).xy;
    sum += cross(point(pair.x).xyz - p.xyz, point(pair.y).xyz - p.xyz);
  }
  float size = length(sum);
  normal = mat3(view) * (size > 0.0 ? sum / size : vec3(0));
  vec4 seen = view * vec4(p.xyz, 1);
  place = seen.xyz;
  texel = vec2(uv.x, 1.0 - uv.y);
  paint = shade.rgb;
  error = p.w;
  gl_Position = projection * seen;
  if (behind > 0.0) {
    vec4 far = projection * vec4(place + behind * normalize(place), 1);
    gl_Position.z = far.z / far.w * gl_Position.w;
  }
  gl_PointSize = clamp(pointSize / gl_Position.w, 2.0, 40.0);
}`;

const DRAW_FRAGMENT = `#version 300 es
precision highp float;
in vec3 normal;
in vec3 place;
in vec2 texel;
in vec3 paint;
in float error;
uniform int mode; // 0 colour alone, 1 texture, 2 colour of the vertex, 3 error
uniform vec4 color;
uniform sampler2D image;
uniform vec3 heat[16];
uniform float top;
uniform bool cloud;
uniform bool outline;
out vec4 pixel;

vec3 linear(vec3 c) { return pow(c, vec3(2.2)); }

void main() {
  vec3 albedo = color.rgb;
  float even = 0.0;
  if (mode == 1) albedo *= linear(texture(image, texel).rgb);
  if (mode == 2) { albedo = linear(paint); even = 0.35; }
  if (mode == 3) {
    float at = clamp(error / top, 0.0, 1.0) * 15.0;
    int low = min(int(at), 14);
    albedo = linear(mix(heat[low], heat[low + 1], at - float(low)));
    even = 0.45;
  }
  vec3 n = normal;
  if (cloud) {
    vec2 at = 2.0 * gl_PointCoord - 1.0;
    if (dot(at, at) > 1.0) discard;
    n = vec3(at.x, -at.y, sqrt(1.0 - dot(at, at)));
  } else if (dot(n, n) == 0.0) {
    n = cross(dFdx(place), dFdy(place));
  }
  n = normalize(n);
  if (dot(n, place) > 0.0) n = -n; // both sides of a surface are lit
  float key = max(0.0, dot(n, normalize(vec3(-0.45, 0.6, 0.75))));
  float fill = max(0.0, dot(n, normalize(vec3(0.8, 0.1, 0.5))));
  float light = 0.26 + 0.10 * n.y + 0.66 * key + 0.20 * fill;
  light = mix(light, 0.92, even);
  float shine = 0.05 * pow(max(0.0, dot(reflect(normalize(place), n), normalize(vec3(-0.45, 0.6, 0.75)))), 24.0);
  pixel = vec4(pow(albedo * light + shine * (1.0 - even), vec3(1.0 / 2.2)), 1.0) * color.a;
  // where a surface turns away, all else is clear
  if (outline) pixel *= pow(1.0 - abs(dot(n, normalize(place))), 2.5);
}`;
