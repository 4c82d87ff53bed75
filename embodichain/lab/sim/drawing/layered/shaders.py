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

from embodichain.lab.sim.drawing.layered.shading_source import (
    LIGHT,
    OVERLAY_FRAGMENT,
    SHADING_FRAGMENT,
    SHADING_VERTEX,
    SKY_FRAGMENT,
)

__all__ = ["UNITS", "overlay", "shading", "shadows", "sky", "surfaces", "transparent"]

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
    "overlay": 9,
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
layout(binding = 9) uniform sampler2DArray overlay;
layout(binding = 10) uniform samplerBuffer order;
layout(binding = 11) uniform sampler2DArray distances;
uniform int geomCount;
uniform vec3 haze;                // its colour
uniform float hazeReach;          // metres: MuJoCo's zfar
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
    return vertex, _source(defines, _BASE_COLOUR, LIGHT, _TRANSPARENT_FRAGMENT)


def shading(defines: Defines) -> tuple[str, str]:
    """Vertex and fragment shader of a whole picture.

    ``FULL`` (four samples, highlights), ``HAZE``, ``EDGES``, ``COLOUR``, ``LIGHTS``,
    ``POSITIONAL``, ``SHADOW_MAPS`` and ``MAP_OF_LIGHT``, an array.
    """
    return _source(defines, SHADING_VERTEX), _source(defines, LIGHT, SHADING_FRAGMENT)


def sky(defines: Defines) -> tuple[str, str]:
    """Vertex and fragment shader of what is behind everything; ``SKY``, ``HAZE``."""
    return _source(defines, SHADING_VERTEX), _source(defines, SKY_FRAGMENT)


def overlay(defines: Defines) -> tuple[str, str]:
    """Vertex and fragment shader that lay transparent surfaces over pictures; ``FULL``."""
    return _source(defines, SHADING_VERTEX), _source(defines, OVERLAY_FRAGMENT)


def shadows(defines: Defines) -> tuple[str, str]:
    """Vertex shader of shadow maps: `SHADOW_MAPS` of each environment; depth only."""
    return _source(defines, _PLACE, _SHADOW_VERTEX), ""
