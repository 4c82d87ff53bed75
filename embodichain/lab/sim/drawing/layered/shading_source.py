"""GLSL of the second stage: light, and pictures of the surfaces that the first stage stored.

Parts of programs that `shaders` puts together.
"""

from __future__ import annotations

__all__ = ["LIGHT", "OVERLAY_FRAGMENT", "SHADING_FRAGMENT", "SHADING_VERTEX", "SKY_FRAGMENT"]

LIGHT = """
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

SHADING_VERTEX = """
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

SHADING_FRAGMENT = """
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
    vec3 seen = lighted(base, eyeAndRow.xyz + away * ray, normalOf(surface), -normalize(ray),
                        backwards, int(eyeAndRow.w), texelFetch(looks, g * 4 + 2).xyz);
#ifdef HAZE
    // Haze begins at a tenth of the way to the horizon, and halves what is seen at each fifth.
    float way = away * min(1.0 / hazeReach, range.x);
    seen = mix(haze, seen, exp2(-max(5.0 * way - 0.5, 0.0)));
#endif
    return seen;
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

SKY_FRAGMENT = """
in vec3 ray;
uniform float sky;                // cube of the sky
layout(location = 0) out vec4 colour;

void main() {
#ifdef SKY
    // A skybox lies on its side: its up is z of the world.
    colour = vec4(textureLod(cubes, vec4(ray.x, ray.z, -ray.y, sky), 0.0).rgb, 1.0);
#ifdef HAZE
    colour.rgb = mix(colour.rgb, haze, exp2(-30.0 * abs(normalize(ray).z)));
#endif
#else
    float up = clamp(0.5 + 0.5 * normalize(ray).z, 0.0, 1.0);
    colour = vec4(mix(vec3(0.85, 0.88, 0.92), vec3(0.55, 0.66, 0.80), up), 1.0);
#endif
}
"""

OVERLAY_FRAGMENT = """
flat in int layer;
layout(location = 0) out vec4 colour;

void main() {
    ivec3 q = ivec3(ivec2(gl_FragCoord.xy), layer);
#ifdef FULL
    q.xy *= 2;
    colour = 0.25 * (texelFetch(overlay, q, 0) + texelFetch(overlay, q + ivec3(1, 0, 0), 0)
                     + texelFetch(overlay, q + ivec3(0, 1, 0), 0)
                     + texelFetch(overlay, q + ivec3(1, 1, 0), 0));
#else
    colour = texelFetch(overlay, q, 0);
#endif
}
"""
