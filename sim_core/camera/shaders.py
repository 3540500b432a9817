"""The programs that colour the pictures, in GLSL. Colours leave them as the square root of linear light."""

_HEAD = "//VTK::System::Dec\n"
_FRAGMENT_HEAD = _HEAD + "//VTK::Output::Dec\n"

_LIGHT_VERTEX = """
uniform mat4 lamp_from_world;
uniform mat4 sky_from_world;
out vec3 in_lamp;
out vec3 in_sky;
void place_in_light(vec3 point, vec3 normal) {
  in_lamp = (lamp_from_world * vec4(point + 0.012 * normal, 1.0)).xyz;
  in_sky = (sky_from_world * vec4(point + 0.07 * normal, 1.0)).xyz;
}
"""

# Chebyshev's bound on the share of a blurred depth map's neighbourhood that lies behind a depth: variance shadow maps.
_LIGHT_FRAGMENT = """
in vec3 in_lamp;
in vec3 in_sky;
uniform sampler2D lamp_map;
uniform sampler2D sky_map;
uniform float lamp_reach;
uniform float sky_reach;
uniform vec3 lamp;
uniform float lamp_share;
uniform float brightness;
uniform vec3 axis;
// Lenses give less light to a picture's corners: half of the cosine's fourth power that an ideal one has.
float falloff(vec3 towards) { float c = dot(towards, axis); return c * c; }
float seen_share(sampler2D map, vec3 place, float reach, float least) {
  vec2 depth = texture(map, place.xy).rg;
  // Where nothing was drawn the map ends at its reach; what is farther away is seen through it.
  float behind = max(min(place.z, reach) - depth.x, 0.0);
  float spread = max(depth.y - depth.x * depth.x, least);
  return spread / (spread + behind * behind);
}
float lit_share() { return smoothstep(0.15, 1.0, seen_share(lamp_map, in_lamp, lamp_reach, 4.0e-5)); }
float open_share() { return seen_share(sky_map, in_sky, sky_reach, 1.0e-3); }
float hall_light(vec3 normal, float open) {
  return mix(0.66, 1.0, 0.5 + 0.5 * normal.z) * mix(0.1, 1.0, open);
}
float all_light(vec3 normal, float lit, float open) {
  float facing = max(dot(normal, lamp), 0.0) * lit;
  return brightness * ((1.0 - lamp_share) * hall_light(normal, open) + 1.55 * lamp_share * facing);
}
"""

SOLID_VERTEX = (
    _HEAD
    + """
in vec4 vertexMC;
in vec3 normal;
in vec2 place;
in vec4 tint;
uniform mat4 clip_from_world;
out vec3 point_at;
out vec3 normal_at;
out vec2 place_at;
out vec4 tint_at;
"""
    + _LIGHT_VERTEX
    + """
void main() {
  point_at = vertexMC.xyz;
  normal_at = normal;
  place_at = place;
  tint_at = tint;
  place_in_light(vertexMC.xyz, normal);
  gl_Position = clip_from_world * vertexMC;
}
"""
)

SOLID_FRAGMENT = (
    _FRAGMENT_HEAD
    + """
in vec3 point_at;
in vec3 normal_at;
in vec2 place_at;
in vec4 tint_at;
uniform sampler2D sheet;
uniform vec3 eye;
"""
    + _LIGHT_FRAGMENT
    + """
void main() {
  vec3 shown = texture(sheet, place_at).rgb;
  float lit = lit_share();
  float open = open_share();
  vec3 light = shown * shown * tint_at.rgb * all_light(normal_at, lit, open);
  vec3 towards = normalize(eye - point_at);
  float glint = max(dot(normal_at, normalize(towards + lamp)), 0.0);
  glint = glint * glint; glint = glint * glint; glint = glint * glint; glint = glint * glint;
  light += tint_at.a * (glint * lit + 0.15 * open);
  gl_FragData[0] = vec4(sqrt(light * falloff(towards)), 1.0);
}
"""
)

# The floor is in the background already: what is drawn is how much darker it gets.
SHADE_FRAGMENT = (
    _FRAGMENT_HEAD
    + """
in vec3 point_at;
in vec3 normal_at;
in vec2 place_at;
in vec4 tint_at;
"""
    + _LIGHT_FRAGMENT
    + """
void main() {
  float share = all_light(normal_at, lit_share(), open_share()) / all_light(normal_at, 1.0, 1.0);
  gl_FragData[0] = vec4(0.0, 0.0, 0.0, 1.0 - sqrt(share));
}
"""
)

DEPTH_VERTEX = (
    _HEAD
    + """
in vec4 vertexMC;
uniform mat4 clip_from_world;
void main() { gl_Position = clip_from_world * vertexMC; }
"""
)

DEPTH_FRAGMENT = _FRAGMENT_HEAD + "void main() { gl_FragData[0] = vec4(1.0); }\n"

FILM_VERTEX = (
    _HEAD
    + """
in vec4 vertexMC;
in vec3 normal;
in vec2 place;
in vec4 tint;
uniform mat4 clip_from_world;
out vec3 point_at;
out vec3 normal_at;
out vec2 place_at;
out vec4 tint_at;
"""
    + _LIGHT_VERTEX
    + """
void main() {
  point_at = vertexMC.xyz;
  normal_at = normal;
  place_at = place;
  tint_at = tint;
  place_in_light(vertexMC.xyz, normal);
  gl_Position = clip_from_world * vertexMC;
}
"""
)

# tint: colour and opacity of what scatters light; folds: slopes around and up, how thick the film lies, its shade.
FILM_FRAGMENT = (
    _FRAGMENT_HEAD
    + """
in vec3 point_at;
in vec3 normal_at;
in vec2 place_at;
in vec4 tint_at;
uniform sampler2D folds;
uniform vec3 eye;
uniform float gloss;
uniform float relief;
uniform float evenness;
"""
    + _LIGHT_FRAGMENT
    + """
float hall_around(vec3 d) {
  // A ceiling with rows of lamps; behind the camera tall windows between piers.
  float ceiling = 0.4 * smoothstep(0.0, 0.9, d.z);
  float rows = smoothstep(0.5, 0.95, sin(9.0 * d.x / max(d.z, 0.15) + 0.6)) * smoothstep(0.25, 0.45, d.z);
  float piers = smoothstep(0.25, 0.95, sin(12.0 * d.x + 2.2));
  float panes = piers * smoothstep(-0.4, 0.1, d.z) * smoothstep(0.45, 0.15, d.z);
  return 0.22 + ceiling + 2.0 * rows + 2.0 * panes;
}
void main() {
  vec3 towards = normalize(eye - point_at);
  vec3 normal = normalize(normal_at);
  normal *= sign(dot(normal, towards) + 1.0e-6);
  vec4 fold = texture(folds, place_at);
  vec3 around = normalize(vec3(-normal.y, normal.x, 1.0e-4));
  vec3 up = cross(normal, around);
  vec2 slope = relief * (fold.rg - 0.5);
  vec3 bent = normalize(normal - slope.x * around - slope.y * up);
  float steep = 1.0 - max(dot(bent, towards), 0.0);
  float mirror = gloss * (0.13 + 0.87 * steep * steep * steep * steep * steep);
  float lit = lit_share();
  float open = open_share();
  float glint = max(dot(bent, normalize(towards + lamp)), 0.0);
  glint = glint * glint; glint = glint * glint; glint = glint * glint; glint = glint * glint;
  glint = glint * glint;
  float shine = mirror * hall_around(reflect(-towards, bent)) * mix(0.5, 1.0, open)
      + gloss * lamp_share * 0.9 * lit * glint * glint;
  float haze = clamp(tint_at.a * mix(0.4 + 1.6 * fold.b, 1.0, evenness), 0.0, 1.0);
  float alpha = clamp(haze + 0.6 * mirror + 0.5 * shine, 0.02, 1.0);
  vec3 light = haze * fold.a * fold.a * tint_at.rgb * all_light(bent, lit, open) + shine;
  gl_FragData[0] = vec4(sqrt(min(light * falloff(towards) / alpha, 1.0)), alpha);
}
"""
)
