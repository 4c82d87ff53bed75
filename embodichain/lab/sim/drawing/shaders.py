"""GLSL sources: scene, background, shadow map. One instance is one picture, drawn to its own layer.

Textures of numbers that all programs read (`samplerBuffer`, four floats a texel):

- ``poses``: an environment's geoms, 3 texels each: the rows of a 3 x 4 pose.
- ``looks``: an environment's geoms, 3 texels each: scale and half length; colour; specular,
  shininess, emission, and texture (see ``surface``).
- ``views``: a picture, 8 texels: the rows of the view projection, eye, environment, and the rays
  through the picture's corner and along its sides.
- ``lights``: an environment's lights, 6 texels each: position and 1 if directional, direction and
  cosine of the cutoff, diffuse and 1 if active, ambient, specular, attenuation and exponent.
"""

from __future__ import annotations

__all__ = ["BACKGROUND", "SCENE_FRAGMENT", "SCENE_VERTEX", "SHADOW_VERTEX"]

_HEAD = """#version 430 core
#extension GL_ARB_shader_viewport_layer_array : require
uniform samplerBuffer poses, looks, views, lights, shadowViews;
uniform int geomCount, lightCount;
"""

_PLACE = """
layout(location = 0) in vec3 position;
layout(location = 1) in vec3 normal;
layout(location = 2) in vec2 texcoord;
layout(location = 3) in float geom;
layout(location = 4) in float end;

vec3 inWorld(int environment, vec3 point, float one) {
    int p = (environment * geomCount + int(geom)) * 3;
    vec4 local = vec4(point, one);
    return vec3(dot(texelFetch(poses, p), local), dot(texelFetch(poses, p + 1), local),
                dot(texelFetch(poses, p + 2), local));
}
"""

SCENE_VERTEX = (
    _HEAD
    + _PLACE
    + """
flat out int geomIndex, environmentIndex;
flat out vec4 rgba, look, scaling;
flat out vec3 eye;
out vec3 worldPosition, worldNormal, localPosition;
out vec2 uv;

void main() {
    int v = gl_InstanceID * 8;
    int environment = int(texelFetch(views, v + 4).w);
    int g = (environment * geomCount + int(geom)) * 3;
    vec4 scale = texelFetch(looks, g);
    scaling = scale;
    rgba = texelFetch(looks, g + 1);
    look = texelFetch(looks, g + 2);
    eye = texelFetch(views, v + 4).xyz;
    localPosition = position * scale.xyz + vec3(0.0, 0.0, end * scale.w);
    worldPosition = inWorld(environment, localPosition, 1.0);
    worldNormal = inWorld(environment, normal / scale.xyz, 0.0);
    uv = texcoord;
    geomIndex = int(geom);
    environmentIndex = environment;
    vec4 at = vec4(worldPosition, 1.0);
    gl_Position = vec4(dot(texelFetch(views, v), at), dot(texelFetch(views, v + 1), at),
                       dot(texelFetch(views, v + 2), at), dot(texelFetch(views, v + 3), at));
    gl_Layer = gl_InstanceID;
}
"""
)

SHADOW_VERTEX = (
    _HEAD
    + _PLACE
    + """
void main() {
    int v = gl_InstanceID * 4;
    vec4 scale = texelFetch(looks, (gl_InstanceID * geomCount + int(geom)) * 3);
    vec3 local = position * scale.xyz + vec3(0.0, 0.0, end * scale.w);
    vec4 at = vec4(inWorld(gl_InstanceID, local, 1.0), 1.0);
    gl_Position = vec4(dot(texelFetch(shadowViews, v), at), dot(texelFetch(shadowViews, v + 1), at),
                       dot(texelFetch(shadowViews, v + 2), at),
                       dot(texelFetch(shadowViews, v + 3), at));
    gl_Layer = gl_InstanceID;
}
"""
)

_TEXTURES = """
uniform sampler2DArray textures;
uniform vec4 textureTable[32];  // first layer, -1 without one; 1 of a cube; repeat u, v
uniform int uniformRepeat[32];

vec3 cubeFace(vec3 d, int first) {
    // Faces in the order right, left, up, down, front, back, as OpenGL's cube maps.
    vec3 a = abs(d);
    int face;
    vec2 st;
    if (a.x >= a.y && a.x >= a.z) {
        face = d.x > 0.0 ? 0 : 1;
        st = vec2(d.x > 0.0 ? -d.z : d.z, -d.y) / a.x;
    } else if (a.y >= a.z) {
        face = d.y > 0.0 ? 2 : 3;
        st = vec2(d.x, d.y > 0.0 ? d.z : -d.z) / a.y;
    } else {
        face = d.z > 0.0 ? 4 : 5;
        st = vec2(d.z > 0.0 ? d.x : -d.x, -d.y) / a.z;
    }
    return texture(textures, vec3(clamp(0.5 + 0.5 * st, 0.002, 0.998), float(first + face))).rgb;
}
"""

SCENE_FRAGMENT = (
    _HEAD
    + _TEXTURES
    + """
flat in int geomIndex, environmentIndex;
flat in vec4 rgba, look, scaling;
flat in vec3 eye;
in vec3 worldPosition, worldNormal, localPosition;
in vec2 uv;
uniform int full;                 // 1: specular light, textures smoothly, shadows
uniform vec3 headAmbient, headDiffuse, headSpecular;
uniform sampler2DArrayShadow shadows;
uniform int shadowLight;          // which light casts, -1 none
uniform int transparentPass;      // 1 draws what is transparent, 0 the rest
layout(location = 0) out vec4 color;
layout(location = 1) out float depth;
layout(location = 2) out int mask;

float lit(vec3 point, vec3 normal) {
    int v = environmentIndex * 4;
    vec4 at = vec4(point + 0.004 * normal, 1.0);
    vec4 clip = vec4(dot(texelFetch(shadowViews, v), at), dot(texelFetch(shadowViews, v + 1), at),
                     dot(texelFetch(shadowViews, v + 2), at),
                     dot(texelFetch(shadowViews, v + 3), at));
    vec3 s = 0.5 + 0.5 * clip.xyz / clip.w;
    if (any(lessThan(s, vec3(0.0))) || any(greaterThan(s, vec3(1.0)))) return 1.0;
    float texel = 1.0 / float(textureSize(shadows, 0).x), sum = 0.0;
    for (int i = -1; i <= 1; i += 2)
        for (int j = -1; j <= 1; j += 2)
            sum += texture(shadows, vec4(s.xy + texel * vec2(i, j), float(environmentIndex),
                                         s.z - 0.0008));
    return 0.25 * sum;
}

vec3 surface(vec3 base, vec4 look) {
    int kind = int(look.w);       // a material's texture, -1 without one
    if (kind < 0) return base;
    vec4 entry = textureTable[kind];
    if (entry.x < 0.0) return base;
    bool repeats = uniformRepeat[kind] == 1;
    if (entry.y == 1.0) return base * cubeFace(localPosition, int(entry.x));
    vec2 st = uv * entry.zw * (repeats ? scaling.xy : vec2(1.0));
    return base * texture(textures, vec3(st, entry.x)).rgb;
}

void main() {
    if (rgba.a <= 0.0 || (rgba.a < 1.0) != (transparentPass == 1)) discard;
    vec3 base = surface(rgba.rgb, look);
    vec3 normal = normalize(worldNormal);
    vec3 toEye = normalize(eye - worldPosition);
    float facing = max(dot(normal, toEye), 0.0);
    vec3 light = headAmbient + headDiffuse * facing;
    vec3 shine = vec3(0.0);
    float exponent = max(look.y * 128.0, 1.0);
    if (full == 1) shine += headSpecular * pow(facing, exponent);
    for (int i = 0; i < lightCount; ++i) {
        int l = (environmentIndex * lightCount + i) * 6;
        vec4 at = texelFetch(lights, l), along = texelFetch(lights, l + 1);
        vec4 diffuse = texelFetch(lights, l + 2), ambient = texelFetch(lights, l + 3);
        if (diffuse.w == 0.0) continue;
        vec3 toLight = -along.xyz;
        float strength = 1.0;
        if (at.w == 0.0) {        // not directional
            vec4 fall = texelFetch(lights, l + 5);
            vec3 gap = at.xyz - worldPosition;
            float far = length(gap);
            toLight = gap / far;
            strength = 1.0 / (fall.x + fall.y * far + fall.z * far * far);
            float inCone = dot(-toLight, along.xyz);
            if (inCone < along.w) strength = 0.0;
            else if (along.w > -1.0) strength *= pow(max(inCone, 0.0), fall.w);
        }
        light += ambient.rgb;
        float direct = max(dot(normal, toLight), 0.0) * strength;
        if (direct > 0.0 && full == 1 && i == shadowLight) direct *= lit(worldPosition, normal);
        light += diffuse.rgb * direct;
        if (full == 1 && direct > 0.0) {
            vec4 specular = texelFetch(lights, l + 4);
            shine += specular.rgb * pow(max(dot(normal, normalize(toLight + toEye)), 0.0), exponent)
                     * min(direct * 4.0, 1.0);
        }
    }
    color = vec4(min(base * (light + look.z) + look.x * shine, 1.0), rgba.a);
    depth = 1.0 / gl_FragCoord.w;
    mask = geomIndex;
}
"""
)

BACKGROUND = (
    _HEAD
    + """
out vec3 ray;

void main() {
    vec2 at = vec2(gl_VertexID == 1 ? 2.0 : 0.0, gl_VertexID == 2 ? 2.0 : 0.0);
    int v = gl_InstanceID * 8;
    ray = texelFetch(views, v + 5).xyz + at.x * texelFetch(views, v + 6).xyz
          + at.y * texelFetch(views, v + 7).xyz;
    gl_Position = vec4(2.0 * at - 1.0, 1.0, 1.0);
    gl_Layer = gl_InstanceID;
}
""",
    _HEAD
    + _TEXTURES
    + """
in vec3 ray;
uniform int sky;                  // entry of the texture table, -1 without one
uniform vec3 clear;
layout(location = 0) out vec4 color;

void main() {
    vec3 d = normalize(ray);
    // A skybox lies on its side: its up is z of the world.
    color = vec4(sky < 0 ? clear : cubeFace(vec3(d.x, d.z, -d.y), int(textureTable[sky].x)), 1.0);
}
""",
)
"""Vertex and fragment shader of the sky, behind everything; writes colour only."""
