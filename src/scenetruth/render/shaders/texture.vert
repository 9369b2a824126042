#version 330 core
// Projects vertices into the image and passes positions on the texture raster.

layout(location = 0) in vec3 position;
#ifdef TWO_SIDED
layout(location = 1) in vec4 tangent;     // texcoord_0 and texcoord_1 for the back of the face
layout(location = 2) in vec2 texcoord_0;  // texels, relative to texel `origin`
layout(location = 3) in vec2 texcoord_1;  // integer texel, common to all corners of a face
layout(location = 4) in mat4 inst_m;
#else
layout(location = 1) in vec2 texcoord_0;
layout(location = 2) in vec2 texcoord_1;
layout(location = 3) in mat4 inst_m;
#endif

uniform mat4 M;
uniform mat4 V;
uniform mat4 P;

out vec2 texel;
flat out vec2 origin;
#ifdef TWO_SIDED
out vec2 texel_back;
flat out vec2 origin_back;
#endif

void main()
{
    gl_Position = P * (V * (M * (inst_m * vec4(position, 1.0))));
    texel = texcoord_0;
    origin = texcoord_1;
#ifdef TWO_SIDED
    texel_back = tangent.xy;
    origin_back = tangent.zw;
#endif
}
