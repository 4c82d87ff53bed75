"""GLSL sources: surfaces, transparent surfaces, shading, shadow maps. An instance is a picture.

Drawing has two stages. `surfaces` stores of the nearest surface its normal, geom, depth and colour
(four integers a sample); `shading` computes a picture of it, each pixel once. Programs are compiled
for what a scene has, by `#define`.

Textures of numbers that the programs read (`samplerBuffer`, four floats a texel):

- ``poses``: an environment's geoms, 3 texels each: the rows of a 3 x 4 pose.
- ``looks``: an environment's geoms, 4 texels each, see `SurfaceTable`.
- ``views``: a picture, 8 texels: the rows of the view projection; eye and row of ``poses`` and
  ``lights``; the rays through the picture's corner, along its width and its height, and in their w
  the axis that points backwards.
- ``lights``: an environment's, 1 texel of ambient light and the row of ``looks``, then 5 of each
  light, see `light_table`.
- ``shadowViews``: an environment's shadow maps, 4 texels each: rows of the view projection.
"""

from __future__ import annotations

from collections.abc import Mapping

__all__ = ["UNITS", "shading", "shadows", "surfaces", "transparent"]

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
uniform int geomCount;
const int NOTHING = 0xffff;

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

vec4 inClip(samplerBuffer rows, int v, vec3 world) {
    vec4 at = vec4(world, 1.0);
    return vec4(dot(texelFetch(rows, v), at), dot(texelFetch(rows, v + 1), at),
                dot(texelFetch(rows, v + 2), at), dot(texelFetch(rows, v + 3), at));
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
    int v = layer * 8;
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
    stored = uvec2(uint(geom), packUnorm4x8(vec4(colour.rgb, 1.0)));
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
    gl_Position = inClip(views, v, world);
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
layout(location = 0) out uvec4 surface;

void main() {
#if defined(TEXTURE_2D) || defined(TEXTURE_CUBE)
    uint colour = packUnorm4x8(vec4(baseColour(), 1.0));
#else
    uint colour = stored.y;
#endif
    surface = uvec4(packSnorm2x16(worldNormal.xy),
                    stored.x | packSnorm2x16(vec2(0.0, worldNormal.z)),
                    floatBitsToUint(1.0 / gl_FragCoord.w), colour);
}
"""

_LIGHT = """
uniform vec3 headDiffuse, headSpecular;

#if SHADOW_MAPS > 0
float lit(int row, int map, vec3 point, vec3 normal) {
    // Four comparisons on a turned square, each of 2 x 2 texels: a soft edge of four texels.
    int v = (row * SHADOW_MAPS + map) * 4;
    float texel = 1.0 / float(textureSize(shadowMaps, 0).x);
    vec4 across = texelFetch(shadowViews, v);
    vec4 at = vec4(point + (4.0 * texel / length(across.xyz)) * normal, 1.0);
    vec4 clip = vec4(dot(across, at), dot(texelFetch(shadowViews, v + 1), at),
                     dot(texelFetch(shadowViews, v + 2), at),
                     dot(texelFetch(shadowViews, v + 3), at));
    vec3 s = 0.5 + 0.5 * clip.xyz / clip.w;
    float layer = float(row * SHADOW_MAPS + map), sum = 0.0, level = min(s.z - 0.0006, 1.0);
    vec2 wide = texel * vec2(1.4, 0.6);
    sum += texture(shadowMaps, vec4(s.xy + wide.xy, layer, level));
    sum += texture(shadowMaps, vec4(s.xy - wide.xy, layer, level));
    sum += texture(shadowMaps, vec4(s.xy + vec2(-wide.y, wide.x), layer, level));
    sum += texture(shadowMaps, vec4(s.xy + vec2(wide.y, -wide.x), layer, level));
    bool outside = any(lessThan(s, vec3(0.0))) || any(greaterThan(s.xy, vec2(1.0)));
    return outside ? 1.0 : 0.25 * sum;
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
        if (MAP_OF_LIGHT[i] >= 0) direct *= lit(row, MAP_OF_LIGHT[i], point, normal);
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
    vec3 seen = lighted(baseColour(), worldPosition, normalize(worldNormal),
                        normalize(eye - worldPosition), backwards, rows.x, finish);
    colour = vec4(alpha * seen, alpha);
}
"""

_SHADING_VERTEX = """
out vec3 ray;
flat out vec4 eyeAndRow;
flat out vec3 backwards;
flat out int lookRow, layer;

void main() {
    vec2 at = vec2(gl_VertexID == 1 ? 2.0 : 0.0, gl_VertexID == 2 ? 2.0 : 0.0);
    int v = gl_InstanceID * 8;
    vec4 corner = texelFetch(views, v + 5), width = texelFetch(views, v + 6);
    vec4 height = texelFetch(views, v + 7);
    ray = corner.xyz + at.x * width.xyz + at.y * height.xyz;
    backwards = vec3(corner.w, width.w, height.w);
    eyeAndRow = texelFetch(views, v + 4);
    lookRow = lookRowOf(int(eyeAndRow.w));
    layer = gl_InstanceID;
    gl_Position = vec4(2.0 * at - 1.0, 0.0, 1.0);
    gl_Layer = gl_InstanceID;
}
"""

_SHADING_FRAGMENT = """
in vec3 ray;
flat in vec4 eyeAndRow;
flat in vec3 backwards;
flat in int lookRow, layer;
uniform float sky;                // cube of the sky, -1 without one
layout(location = 0) out vec4 colour;
layout(location = 1) out float depth;
layout(location = 2) out int mask;

int geomOf(uvec4 surface) { return int(surface.y & 0xffffu); }

vec3 normalOf(uvec4 surface) {
    return normalize(vec3(unpackSnorm2x16(surface.x), unpackSnorm2x16(surface.y).y));
}

vec3 behind() {
#ifdef SKY
    // A skybox lies on its side: its up is z of the world.
    return textureLod(cubes, vec4(ray.x, ray.z, -ray.y, sky), 0.0).rgb;
#else
    float up = clamp(0.5 + 0.5 * normalize(ray).z, 0.0, 1.0);
    return mix(vec3(0.85, 0.88, 0.92), vec3(0.55, 0.66, 0.80), up);
#endif
}

vec3 shaded(uvec4 surface, vec3 base, vec3 toEye) {
    int geom = geomOf(surface);
    if (geom == NOTHING) return behind();
    vec3 point = eyeAndRow.xyz + uintBitsToFloat(surface.z) * ray;
    vec3 finish = texelFetch(looks, (lookRow * geomCount + geom) * 4 + 2).xyz;
    return lighted(base, point, normalOf(surface), toEye, backwards, int(eyeAndRow.w), finish);
}

vec3 baseOf(uvec4 surface) { return unpackUnorm4x8(surface.w).rgb; }

void main() {
    vec3 toEye = -normalize(ray);
#ifdef FULL
    // Four samples a pixel. Where they show the same smooth surface, it is shaded once.
    ivec3 q = ivec3(2 * ivec2(gl_FragCoord.xy), layer);
    uvec4 a = texelFetch(surfaces, q, 0), b = texelFetch(surfaces, q + ivec3(1, 0, 0), 0);
    uvec4 c = texelFetch(surfaces, q + ivec3(0, 1, 0), 0);
    uvec4 d = texelFetch(surfaces, q + ivec3(1, 1, 0), 0);
    ivec4 geoms = ivec4(geomOf(a), geomOf(b), geomOf(c), geomOf(d));
    vec3 first = normalOf(a);
    float turned = min(dot(first, normalOf(d)), min(dot(first, normalOf(b)),
                                                    dot(first, normalOf(c))));
    bool same = geoms == ivec4(geoms.x) && (turned > 0.97 || geoms.x == NOTHING);
    vec3 mean = 0.25 * (baseOf(a) + baseOf(b) + baseOf(c) + baseOf(d)), sum = vec3(0.0);
    int samples = same ? 1 : 4;
    for (int i = 0; i < samples; ++i) {
        uvec4 surface = texelFetch(surfaces, q + ivec3(i & 1, i >> 1, 0), 0);
        sum += shaded(surface, same ? mean : baseOf(surface), toEye);
    }
    vec3 seen = sum / float(samples);
#ifdef VEIL
    vec4 over = 0.25 * (texelFetch(veil, q, 0) + texelFetch(veil, q + ivec3(1, 0, 0), 0)
                        + texelFetch(veil, q + ivec3(0, 1, 0), 0)
                        + texelFetch(veil, q + ivec3(1, 1, 0), 0));
    seen = seen * (1.0 - over.a) + over.rgb;
#endif
    colour = vec4(seen, 1.0);
#else
    ivec3 q = ivec3(ivec2(gl_FragCoord.xy), layer);
    uvec4 surface = texelFetch(surfaces, q, 0);
    int geom = geomOf(surface);
    depth = uintBitsToFloat(surface.z);
    mask = geom == NOTHING ? -1 : geom;
#ifdef COLOUR
    vec3 seen = shaded(surface, baseOf(surface), toEye);
#ifdef VEIL
    vec4 over = texelFetch(veil, q, 0);
    seen = seen * (1.0 - over.a) + over.rgb;
#endif
    colour = vec4(seen, 1.0);
#endif
#endif
}
"""

_SHADOW_VERTEX = """
void main() {
    int row = gl_InstanceID / SHADOW_MAPS;
    int g = (lookRowOf(row) * geomCount + int(geom)) * 4;
    vec4 scale = texelFetch(looks, g);
    vec3 local = position * scale.xyz + vec3(0.0, 0.0, end * scale.w);
    gl_Position = inClip(shadowViews, gl_InstanceID * 4, inWorld(row, local, 1.0));
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

    ``FULL`` (four samples, highlights), ``COLOUR``, ``SKY``, ``VEIL`` (of what is transparent),
    ``LIGHTS``, ``POSITIONAL``, ``SHADOW_MAPS`` and ``MAP_OF_LIGHT``, an array.
    """
    vertex = _source(defines, _SHADING_VERTEX)
    return vertex, _source(defines, _LIGHT, _SHADING_FRAGMENT)


def shadows(defines: Defines) -> tuple[str, str]:
    """Vertex shader of shadow maps: `SHADOW_MAPS` of each environment; depth only."""
    return _source(defines, _PLACE, _SHADOW_VERTEX), ""
