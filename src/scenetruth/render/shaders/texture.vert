#version 330 core
// Carries vertices into the image, and positions on the texture's raster along.

layout(location = 0) in vec3 position;
layout(location = 1) in vec2 texcoord_0;  // texels, from texel `origin` on
layout(location = 2) in vec2 texcoord_1;  // whole texels; the same for all corners of a face
layout(location = 3) in mat4 inst_m;

uniform mat4 M;
uniform mat4 V;
uniform mat4 P;

out vec2 texel;
flat out vec2 origin;

void main()
{
    gl_Position = P * (V * (M * (inst_m * vec4(position, 1.0))));
    texel = texcoord_0;
    origin = texcoord_1;
}
