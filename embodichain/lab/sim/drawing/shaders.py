"""GLSL sources: surfaces, transparent surfaces, shading, shadow maps. An instance is a picture.

Drawing has two stages. `surfaces` stores geom, normal and colour of the nearest surface in 64 bits
a sample; `shading` computes pictures of them, each pixel once. Programs are compiled for what a
scene has, by `#define`. Depth is 1 at `near` and 0 at `far`, which floats resolve best.

Textures of numbers that the programs read (`samplerBuffer`, four floats a texel):

- ``poses``: an environment's geoms, 3 texels each: the rows of a 3 x 4 pose.
- ``looks``: an environment's geoms, 4 texels each, see `SurfaceTable`.
- ``views``: a picture, 9 texels: the rows of the view projection; eye and row of ``poses`` and
  ``lights``; the rays through the picture's corner, along its width and its height, and in their w
  the axis that points backwards; 1 / far and 1 / near - 1 / far.
- ``lights``: an environment's, 1 texel of ambient light and the row of ``looks``, then 5 of each
  light, see `light_table`.
- ``shadowViews``: an environment's shadow maps, 4 texels each: rows of the view projection.
"""

from __future__ import annotations

from collections.abc import Mapping

__all__ = ["UNITS", "shading", "shadows", "sky", "surfaces", "transparent", "veil"]

UNITS = {
    "poses": 0,
    "looks": 1,
    "views": 2,
    "lights": 3,
    "shadowViews": 4,
    "textures": 5,
    "cubes": 6,
    "shadowMaps": 7,
    "surfaces": 8,
    "veil": 9,
    "order": 10,
    "distances": 11,
}
"""Texture units of the samplers."""

_HEAD = """#version 430 core
#extension GL_ARB_shader_viewport_layer_array : require
layout(binding = 0) uniform samplerBuffer poses;
layout(binding = 1) uniform samplerBuffer looks;
layout(binding = 2) uniform samplerBuffer views;
layout(binding = 3) uniform samplerBuffer lights;
layout(binding = 4) uniform samplerBuffer shadowViews;
layout(binding = 5) uniform sampler2DArray textures;
layout(binding = 6) uniform samplerCubeArray cubes;
layout(binding = 7) uniform sampler2DArrayShadow shadowMaps;
layout(binding = 8) uniform usampler2DArray surfaces;
layout(binding = 9) uniform sampler2DArray veil;
layout(binding = 10) uniform samplerBuffer order;
layout(binding = 11) uniform sampler2DArray distances;
uniform int geomCount;
const int NOTHING = 0xffff;
const float CLOSED = 0.0, OPEN = 0.5, EDGE = 1.0;  // depths: drawn; sky is seen; a second surface

vec4 inClip(samplerBuffer rows, int v, vec4 at) {
    return vec4(dot(texelFetch(rows, v), at), dot(texelFetch(rows, v + 1), at),
                dot(texelFetch(rows, v + 2), at), dot(texelFetch(rows, v + 3), at));
}

int lookRowOf(int row) { return int(texelFetch(lights, row * (1 + 5 * LIGHTS)).w); }
"""

_PLACE = """
layout(location = 0) in vec3 position;
layout(location = 1) in vec3 normal;
layout(location = 2) in vec2 texcoord;
layout(location = 3) in float geom;
layout(location = 4) in float end;
uniform float far;                // half the width of a plane without an edge

vec3 inWorld(int row, vec3 point, float one) {
    int p = (row * geomCount + int(geom)) * 3;
    vec4 local = vec4(point, one);
    return vec3(dot(texelFetch(poses, p), local), dot(texelFetch(poses, p + 1), local),
                dot(texelFetch(poses, p + 2), local));
}

"""

_SURFACE_VERTEX = """
uniform int firstOfOrder;
flat out uvec2 stored;            // geom, colour
out vec3 worldNormal;
#if defined(TEXTURE_2D) || defined(TEXTURE_CUBE)
flat out vec4 rgba;
flat out vec2 textureLayers;      // of textures, of cubes; -1 without
out vec3 localPosition;
out vec2 uv;
#endif
#ifdef TRANSPARENT
flat out ivec2 rows;              // of lights, of looks
flat out float alpha;
flat out vec3 eye, backwards;
out vec3 worldPosition;
#endif

void main() {
#ifdef TRANSPARENT
    int layer = int(texelFetch(order, firstOfOrder + gl_InstanceID).x);
#else
    int layer = gl_InstanceID;
#endif
    int v = layer * 9;
    vec4 eyeAndRow = texelFetch(views, v + 4);
    int row = int(eyeAndRow.w);
    int lookRow = lookRowOf(row);
    int g = (lookRow * geomCount + int(geom)) * 4;
    vec4 scale = texelFetch(looks, g);
    vec4 colour = texelFetch(looks, g + 1);
    bvec2 endless = equal(scale.xy, vec2(0.0));
    scale.xy = mix(scale.xy, vec2(far), endless);
    vec3 local = position * scale.xyz + vec3(0.0, 0.0, end * scale.w);
    vec3 world = inWorld(row, local, 1.0);
    worldNormal = normalize(inWorld(row, normal / scale.xyz, 0.0));
    stored = uvec2(uint(geom), packUnorm4x8(vec4(colour.rgb, 0.0)));
#if defined(TEXTURE_2D) || defined(TEXTURE_CUBE)
    vec4 finish = texelFetch(looks, g + 2), mapping = texelFetch(looks, g + 3);
    rgba = colour;
    textureLayers = vec2(finish.w, mapping.z);
    localPosition = local;
    // A plane without an edge has a texture's middle in its own, and repeats by the metre.
    vec2 repeat = mapping.xy * mix(vec2(1.0), scale.xy, bvec2(mapping.w == 1.0 || endless.x,
                                                              mapping.w == 1.0 || endless.y));
    uv = mix(texcoord * repeat, (texcoord - 0.5) * repeat + 0.5, endless);
#endif
    gl_Position = inClip(views, v, vec4(world, 1.0));
    gl_Layer = layer;
#ifdef TRANSPARENT
    rows = ivec2(row, lookRow);
    alpha = colour.a;
    eye = eyeAndRow.xyz;
    backwards = vec3(texelFetch(views, v + 5).w, texelFetch(views, v + 6).w,
                     texelFetch(views, v + 7).w);
    worldPosition = world;
    bool drawn = colour.a > 0.0 && colour.a < 1.0;
#else
    bool drawn = colour.a >= 1.0;
#endif
    if (!drawn) gl_Position = vec4(2.0, 2.0, 2.0, 1.0);  // outside: all vertices of the geom are
}
"""

_BASE_COLOUR = """
flat in uvec2 stored;
in vec3 worldNormal;
#if defined(TEXTURE_2D) || defined(TEXTURE_CUBE)
flat in vec4 rgba;
flat in vec2 textureLayers;
in vec3 localPosition;
in vec2 uv;
#endif

vec3 baseColour() {
#if defined(TEXTURE_2D) || defined(TEXTURE_CUBE)
    vec3 base = rgba.rgb;
#ifdef TEXTURE_2D
    vec3 flatTexel = texture(textures, vec3(uv, max(textureLayers.x, 0.0))).rgb;
    if (textureLayers.x >= 0.0) base *= flatTexel;
#endif
#ifdef TEXTURE_CUBE
    vec3 cubeTexel = texture(cubes, vec4(localPosition, max(textureLayers.y, 0.0))).rgb;
    if (textureLayers.y >= 0.0) base *= cubeTexel;
#endif
    return base;
#else
    return unpackUnorm4x8(stored.y).rgb;
#endif
}
"""

_SURFACE_FRAGMENT = """
layout(location = 0) out uvec2 surface;

void main() {
#if defined(TEXTURE_2D) || defined(TEXTURE_CUBE)
    uint colour = packUnorm4x8(vec4(baseColour(), 0.0));
#else
    uint colour = stored.y;
#endif
    // The normal on an octahedron, 12 bits a coordinate (Cigolle et al. 2014, JCGT 3(2)).
    vec3 size = abs(worldNormal);
    vec3 n = worldNormal / (size.x + size.y + size.z);
    vec2 folded = (1.0 - abs(n.yx)) * mix(vec2(-1.0), vec2(1.0), greaterThanEqual(n.xy, vec2(0.0)));
    uvec2 place = uvec2((n.z >= 0.0 ? n.xy : folded) * 2047.0 + 2047.5);
    uint bits = place.x | place.y << 12;
    surface = uvec2(colour | bits << 24, stored.x | (bits >> 8) << 16);
}
"""

_LIGHT = """
uniform vec3 headDiffuse, headSpecular;

#if SHADOW_MAPS > 0
vec4 inMaps[SHADOW_MAPS];         // the point that is shaded, as lights see it

float lit(int row, int map) {
    vec4 clip = inMaps[map];
    vec3 s = clip.xyz / clip.w;
    s.xy = 0.5 + 0.5 * s.xy;
    bool inside = all(greaterThan(s, vec3(0.0))) && all(lessThan(s.xy, vec2(1.0)));
    // Four comparisons on a turned square, each of 2 x 2 texels: a soft edge of four texels.
    float layer = float(row * SHADOW_MAPS + map), level = min(s.z - 0.001, 1.0);
    vec2 aside = vec2(1.4, 0.6) / float(textureSize(shadowMaps, 0).x);
    vec2 across = vec2(-aside.y, aside.x), none = vec2(0.0);
    float sum = textureGrad(shadowMaps, vec4(s.xy + aside, layer, level), none, none)
                + textureGrad(shadowMaps, vec4(s.xy - aside, layer, level), none, none)
                + textureGrad(shadowMaps, vec4(s.xy + across, layer, level), none, none)
                + textureGrad(shadowMaps, vec4(s.xy - across, layer, level), none, none);
    return inside ? 0.25 * sum : 1.0;
}
#endif

vec3 lighted(vec3 base, vec3 point, vec3 normal, vec3 toEye, vec3 backwards, int row, vec3 finish) {
    int l = row * (1 + 5 * LIGHTS);
    float facing = max(dot(normal, backwards), 0.0);
    vec3 light = texelFetch(lights, l).rgb;
#ifdef FULL
    light *= 0.9 + 0.2 * normal.z;                // the sky is brighter than the ground
#endif
    light += headDiffuse * facing + finish.z;
    vec3 shine = vec3(0.0);
#ifdef FULL
    float exponent = max(finish.y * 128.0, 1.0);
    shine += headSpecular * pow(max(dot(normal, normalize(backwards + toEye)), 0.0), exponent);
#endif
#if LIGHTS > 0
    for (int i = 0; i < LIGHTS; ++i) {
        int t = l + 1 + 5 * i;
        vec4 along = texelFetch(lights, t), diffuse = texelFetch(lights, t + 1);
        vec3 toLight = -along.xyz;
        float strength = 1.0;
#ifdef POSITIONAL
        if (along.w != 0.0) {                     // not directional
            vec4 at = texelFetch(lights, t + 3), fall = texelFetch(lights, t + 4);
            vec3 gap = at.xyz - point;
            float distance = length(gap);
            toLight = gap / distance;
            strength = 1.0 / (fall.x + distance * (fall.y + distance * fall.z));
            float inCone = -dot(toLight, along.xyz);
            if (at.w > -1.0)
                strength *= inCone < at.w ? 0.0 : pow(max(inCone, 0.0), fall.w);
        }
#endif
        float direct = max(dot(normal, toLight), 0.0) * strength;
#if SHADOW_MAPS > 0
        if (MAP_OF_LIGHT[i] >= 0) direct *= lit(row, MAP_OF_LIGHT[i]);
#endif
        light += diffuse.rgb * direct;
#ifdef FULL
        vec3 specular = texelFetch(lights, t + 2).rgb;
        shine += specular * pow(max(dot(normal, normalize(toLight + toEye)), 0.0), exponent)
                 * min(4.0 * direct, 1.0);
#endif
    }
#endif
    return min(base * light + finish.x * shine, 1.0);
}
"""

_TRANSPARENT_FRAGMENT = """
flat in ivec2 rows;
flat in float alpha;
flat in vec3 eye, backwards;
in vec3 worldPosition;
layout(location = 0) out vec4 colour;

void main() {
    vec3 finish = texelFetch(looks, (rows.y * geomCount + int(stored.x)) * 4 + 2).xyz;
#if SHADOW_MAPS > 0
    for (int i = 0; i < SHADOW_MAPS; ++i)
        inMaps[i] = inClip(shadowViews, (rows.x * SHADOW_MAPS + i) * 4, vec4(worldPosition, 1.0));
#endif
    vec3 seen = lighted(baseColour(), worldPosition, normalize(worldNormal),
                        normalize(eye - worldPosition), backwards, rows.x, finish);
    colour = vec4(alpha * seen, alpha);
}
"""

_SHADING_VERTEX = """
uniform float closer;             // than the depths of pixels that are drawn
out vec3 ray;
flat out vec4 eyeAndRow;
flat out vec2 range;              // 1 / far, 1 / near - 1 / far
flat out vec3 backwards;
flat out int lookRow, layer;
#if SHADOW_MAPS > 0
flat out vec4 eyeInMaps[SHADOW_MAPS];
out vec4 rayInMaps[SHADOW_MAPS];
#endif

void main() {
    vec2 at = vec2(gl_VertexID == 1 ? 2.0 : 0.0, gl_VertexID == 2 ? 2.0 : 0.0);
    int v = gl_InstanceID * 9;
    vec4 corner = texelFetch(views, v + 5), width = texelFetch(views, v + 6);
    vec4 height = texelFetch(views, v + 7);
    ray = corner.xyz + at.x * width.xyz + at.y * height.xyz;
    backwards = vec3(corner.w, width.w, height.w);
    eyeAndRow = texelFetch(views, v + 4);
    range = texelFetch(views, v + 8).xy;
    lookRow = lookRowOf(int(eyeAndRow.w));
    layer = gl_InstanceID;
#if SHADOW_MAPS > 0
    for (int i = 0; i < SHADOW_MAPS; ++i) {
        int map = (int(eyeAndRow.w) * SHADOW_MAPS + i) * 4;
        eyeInMaps[i] = inClip(shadowViews, map, vec4(eyeAndRow.xyz, 1.0));
        rayInMaps[i] = inClip(shadowViews, map, vec4(ray, 0.0));
    }
#endif
    gl_Position = vec4(2.0 * at - 1.0, closer, 1.0);
    gl_Layer = gl_InstanceID;
}
"""

_SHADING_FRAGMENT = """
in vec3 ray;
flat in vec4 eyeAndRow;
flat in vec2 range;
flat in vec3 backwards;
flat in int lookRow, layer;
#if SHADOW_MAPS > 0
flat in vec4 eyeInMaps[SHADOW_MAPS];
in vec4 rayInMaps[SHADOW_MAPS];
#endif
layout(location = 0) out vec4 colour;
layout(location = 1) out float depth;
layout(location = 2) out int mask;

int geomOf(uvec2 surface) { return int(surface.y & 0xffffu); }

vec3 baseOf(uvec2 surface) { return unpackUnorm4x8(surface.x).rgb; }

vec2 placeOf(uvec2 surface) {     // of the normal on the octahedron
    uint bits = surface.x >> 24 | (surface.y >> 16) << 8;
    return vec2(bits & 0xfffu, bits >> 12) / 2047.0 - 1.0;
}

vec3 normalOf(uvec2 surface) {
    vec2 place = placeOf(surface);
    vec3 n = vec3(place, 1.0 - abs(place.x) - abs(place.y));
    n.xy += mix(vec2(1.0), vec2(-1.0), greaterThanEqual(n.xy, vec2(0.0))) * max(-n.z, 0.0);
    return normalize(n);
}

float awayOf(ivec3 sampled) {     // metres along the axis
    return 1.0 / (range.x + texelFetch(distances, sampled, 0).x * range.y);
}

vec3 shaded(uvec2 surface, vec3 base, float away) {
#if SHADOW_MAPS > 0
    for (int i = 0; i < SHADOW_MAPS; ++i) inMaps[i] = eyeInMaps[i] + away * rayInMaps[i];
#endif
    int g = lookRow * geomCount + min(geomOf(surface), geomCount - 1);
    return lighted(base, eyeAndRow.xyz + away * ray, normalOf(surface), -normalize(ray), backwards,
                   int(eyeAndRow.w), texelFetch(looks, g * 4 + 2).xyz);
}

#ifdef FULL
float same(uvec2 a, uvec2 b) {
    vec2 turned = abs(placeOf(a) - placeOf(b));
    return geomOf(a) == geomOf(b) && turned.x + turned.y < 0.25 ? 1.0 : 0.0;
}
#endif

// What else a pixel needs is its depth, and later draws pass over the others: a draw's depth test
// ends the work on a block of pixels; a branch, a loop or discarding does not (llvmpipe).
void main() {
    ivec3 q = ivec3(ivec2(gl_FragCoord.xy), layer);
#ifdef FULL
    // Four samples. They show the surface of the first, which is drawn here; or another, which is
    // drawn by the program with EDGES and added; or the sky.
    q.xy *= 2;
    uvec2 a = texelFetch(surfaces, q, 0).xy, b = texelFetch(surfaces, q + ivec3(1, 0, 0), 0).xy;
    uvec2 c = texelFetch(surfaces, q + ivec3(0, 1, 0), 0).xy;
    uvec2 d = texelFetch(surfaces, q + ivec3(1, 1, 0), 0).xy;
    vec4 hit = vec4(notEqual(ivec4(geomOf(a), geomOf(b), geomOf(c), geomOf(d)), ivec4(NOTHING)));
    uvec2 first = hit.x > 0.0 ? a : hit.y > 0.0 ? b : hit.z > 0.0 ? c : d;
    vec4 chosen = hit * vec4(same(first, a), same(first, b), same(first, c), same(first, d));
    float hits = dot(hit, vec4(1.0));
#ifdef EDGES
    chosen = hit - chosen;
    first = chosen.x > 0.0 ? a : chosen.y > 0.0 ? b : chosen.z > 0.0 ? c : d;
#endif
    int place = chosen.x > 0.0 ? 0 : chosen.y > 0.0 ? 1 : chosen.z > 0.0 ? 2 : 3;
    float away = awayOf(q + ivec3(place & 1, place >> 1, 0)), count = dot(chosen, vec4(1.0));
    vec3 base = chosen.x * baseOf(a) + chosen.y * baseOf(b) + chosen.z * baseOf(c)
                + chosen.w * baseOf(d);
    colour = vec4(0.25 * count * shaded(first, base / max(count, 1.0), away), 0.25 * hits);
#ifndef EDGES
    gl_FragDepth = count < hits ? EDGE : hits < 4.0 ? OPEN : CLOSED;
#endif
#else
    uvec2 surface = texelFetch(surfaces, q, 0).xy;
    bool hit = geomOf(surface) != NOTHING;
    float away = awayOf(q);
    depth = hit ? away : 0.0;
    mask = hit ? geomOf(surface) : -1;
#if COLOUR
    colour = hit ? vec4(shaded(surface, baseOf(surface), away), 1.0) : vec4(0.0);
    gl_FragDepth = hit ? CLOSED : OPEN;
#endif
#endif
}
"""

_SKY_FRAGMENT = """
in vec3 ray;
uniform float sky;                // cube of the sky
layout(location = 0) out vec4 colour;

void main() {
#ifdef SKY
    // A skybox lies on its side: its up is z of the world.
    colour = vec4(textureLod(cubes, vec4(ray.x, ray.z, -ray.y, sky), 0.0).rgb, 1.0);
#else
    float up = clamp(0.5 + 0.5 * normalize(ray).z, 0.0, 1.0);
    colour = vec4(mix(vec3(0.85, 0.88, 0.92), vec3(0.55, 0.66, 0.80), up), 1.0);
#endif
}
"""

_VEIL_FRAGMENT = """
flat in int layer;
layout(location = 0) out vec4 colour;

void main() {
    ivec3 q = ivec3(ivec2(gl_FragCoord.xy), layer);
#ifdef FULL
    q.xy *= 2;
    colour = 0.25 * (texelFetch(veil, q, 0) + texelFetch(veil, q + ivec3(1, 0, 0), 0)
                     + texelFetch(veil, q + ivec3(0, 1, 0), 0)
                     + texelFetch(veil, q + ivec3(1, 1, 0), 0));
#else
    colour = texelFetch(veil, q, 0);
#endif
}
"""

_SHADOW_VERTEX = """
void main() {
    int row = gl_InstanceID / SHADOW_MAPS;
    int g = (lookRowOf(row) * geomCount + int(geom)) * 4;
    vec4 scale = texelFetch(looks, g);
    vec3 local = position * scale.xyz + vec3(0.0, 0.0, end * scale.w);
    gl_Position = inClip(shadowViews, gl_InstanceID * 4, vec4(inWorld(row, local, 1.0), 1.0));
    if (texelFetch(looks, g + 1).a < 1.0) gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
    gl_Layer = gl_InstanceID;
}
"""

Defines = Mapping[str, object]


def _source(defines: Defines, *parts: str) -> str:
    lines = "".join(f"#define {name} {value}\n" for name, value in defines.items())
    version, _, rest = _HEAD.partition("\n")
    extension, _, rest = rest.partition("\n")
    return "\n".join([version, extension, lines, rest, *parts])


def surfaces(defines: Defines) -> tuple[str, str]:
    """Vertex and fragment shader of what is opaque; ``TEXTURE_2D``, ``TEXTURE_CUBE``."""
    vertex = _source(defines, _PLACE, _SURFACE_VERTEX)
    return vertex, _source(defines, _BASE_COLOUR, _SURFACE_FRAGMENT)


def transparent(defines: Defines) -> tuple[str, str]:
    """Vertex and fragment shader of what is transparent: those of `surfaces` and of `shading`."""
    defines = {"TRANSPARENT": 1, **defines}
    vertex = _source(defines, _PLACE, _SURFACE_VERTEX)
    return vertex, _source(defines, _BASE_COLOUR, _LIGHT, _TRANSPARENT_FRAGMENT)


def shading(defines: Defines) -> tuple[str, str]:
    """Vertex and fragment shader of a whole picture.

    ``FULL`` (four samples, highlights), ``EDGES``, ``COLOUR``, ``LIGHTS``, ``POSITIONAL``,
    ``SHADOW_MAPS`` and ``MAP_OF_LIGHT``, an array.
    """
    return _source(defines, _SHADING_VERTEX), _source(defines, _LIGHT, _SHADING_FRAGMENT)


def sky(defines: Defines) -> tuple[str, str]:
    """Vertex and fragment shader of what is behind everything; ``SKY`` if there is a skybox."""
    return _source(defines, _SHADING_VERTEX), _source(defines, _SKY_FRAGMENT)


def veil(defines: Defines) -> tuple[str, str]:
    """Vertex and fragment shader that lay transparent surfaces over pictures; ``FULL``."""
    return _source(defines, _SHADING_VERTEX), _source(defines, _VEIL_FRAGMENT)


def shadows(defines: Defines) -> tuple[str, str]:
    """Vertex shader of shadow maps: `SHADOW_MAPS` of each environment; depth only."""
    return _source(defines, _PLACE, _SHADOW_VERTEX), ""
