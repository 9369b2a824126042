#version 330 core
#extension GL_ARB_texture_gather : require
// Evaluates a texture in 32-bit floats. Texture units may interpolate with 8-bit weights, so texels are only fetched.
// The raster has a margin: one texel before the first column and row, two after the last.

struct Material {
    sampler2D base_color_texture;
};
uniform Material material;

#ifdef TWO_SIDED
in vec2 texel_back;
flat in vec2 origin_back;
in vec2 texel;
flat in vec2 origin;
#define TEXEL (gl_FrontFacing ? texel : texel_back)
#define ORIGIN (gl_FrontFacing ? origin : origin_back)
#else
in vec2 texel;
flat in vec2 origin;
#define TEXEL texel
#define ORIGIN origin
#endif

out vec4 frag_color;

// Four texels at `at` and `at` + 1: lower left, lower right, upper right, upper left, with row 0 at the top.
vec4 four(vec2 at, vec2 texels)
{
    return textureGather(material.base_color_texture, (at + 1.0) / texels);
}

void main()
{
    vec2 texels = vec2(textureSize(material.base_color_texture, 0));
    vec2 size = texels - 3.0;
#ifdef TILED
    vec2 first = floor(TEXEL);
    vec2 a = TEXEL - first;
    first += ORIGIN;
    first -= size * floor(first / size);
#else
    vec2 inside = clamp(TEXEL + ORIGIN, vec2(0.0), size - 1.0);
    vec2 first = floor(inside);
    vec2 a = inside - first;
#endif
    vec2 b = 1.0 - a;
#ifdef CUBIC
    vec2 w0 = b * b * b;
    vec2 w3 = a * a * a;
    vec2 w1 = 4.0 - 6.0 * a * a + 3.0 * w3;
    vec2 w2 = 4.0 - 6.0 * b * b + 3.0 * w0;
    vec4 nw = four(first, texels);
    vec4 ne = four(first + vec2(2.0, 0.0), texels);
    vec4 sw = four(first + vec2(0.0, 2.0), texels);
    vec4 se = four(first + vec2(2.0, 2.0), texels);
    float row0 = w0.x * nw.w + w1.x * nw.z + w2.x * ne.w + w3.x * ne.z;
    float row1 = w0.x * nw.x + w1.x * nw.y + w2.x * ne.x + w3.x * ne.y;
    float row2 = w0.x * sw.w + w1.x * sw.z + w2.x * se.w + w3.x * se.z;
    float row3 = w0.x * sw.x + w1.x * sw.y + w2.x * se.x + w3.x * se.y;
    float radiance = (w0.y * row0 + w1.y * row1 + w2.y * row2 + w3.y * row3) / 36.0;
#else
    vec4 near = four(first + 1.0, texels);
    float radiance = b.y * (b.x * near.w + a.x * near.z) + a.y * (b.x * near.x + a.x * near.y);
#endif
    frag_color = vec4(radiance, radiance, radiance, 1.0);
}
