// A corner of a part. Where the device's rasteriser covers what the CPU's does (it has 8 bits below the pixel), parts go
// there as they are: corners within the viewport, w = 1, and no rounding from the grid to the pixel, since the viewport's
// side is a power of two. What reaches out of the viewport would be cut at places of the device's choice: such parts are
// left out here, and come again (kJudged) as a triangle over their pixels, each of which the fragment shader judges.
#version 460
#include "vulkan/shaders/peeling.glsl"

layout(constant_id = 2) const uint kJudged = 0;

layout(buffer_reference, scalar, buffer_reference_align = 4) readonly buffer Words { uint at[]; };
layout(buffer_reference, scalar, buffer_reference_align = 4) readonly buffer Numbers { int at[]; };
layout(push_constant, scalar) uniform Push { PeelDrawPush push; };

layout(location = 0) flat out uvec4 plane_0;  // the triangle's PeelPlane, by its bits
layout(location = 1) flat out uvec4 plane_1;
layout(location = 2) flat out uvec4 plane_2;
layout(location = 3) flat out uvec4 plane_3;
layout(location = 4) flat out uvec4 plane_4;  // its last double, the numbers of part and object

uvec4 bits_of(double a, double b) { return uvec4(unpackDouble2x32(a), unpackDouble2x32(b)); }

void main() {
    uint part_number = uint(gl_VertexIndex) / 3u;
    uint corner = uint(gl_VertexIndex) - 3u * part_number;
    int left = push.viewport_x * 256;
    int top = push.viewport_y * 256;
    uint object = 0u;
    int x;
    int y;
    if (kJudged != 0u) {
        // Twice the rectangle and a pixel around it, cut to the rows at hand.
        part_number = Words(push.judged).at[part_number];
        PeelPart p = Parts(push.parts).at[part_number];
        object = p.object;
        int x_first = max(min(min(p.x0, p.x1), p.x2), 0) - 256;
        int y_first = max(min(min(p.y0, p.y1), p.y2), push.first_row * 256) - 256;
        int wide = 2 * (min(max(max(p.x0, p.x1), p.x2), push.width * 256) - x_first) + 1024;
        int high = 2 * (min(max(max(p.y0, p.y1), p.y2), (push.first_row + push.rows) * 256) - y_first) + 1024;
        x = x_first + (corner == 1 ? wide : 0);
        y = y_first + (corner == 2 ? high : 0);
    } else {
        // Its own corner alone: software is slow to read what lies behind an address.
        uint64_t part = push.parts + 32ul * uint64_t(part_number);
        object = Words(part).at[7];
        x = Numbers(part + 4ul * uint64_t(corner)).at[0];
        y = Numbers(part + 12ul + 4ul * uint64_t(corner)).at[0];
        if ((object & kPeelJudged) != 0u) {
            x = left;
            y = top;
        }
    }
    float to_device = 2.0 / float(push.viewport_side * 256);  // exact
    gl_Position = vec4((float(x - left) + push.shift) * to_device - 1.0, float(y - top) * to_device - 1.0, 0.5, 1.0);

    // Of the first corner the flat outputs count.
    plane_0 = uvec4(0u);
    plane_1 = uvec4(0u);
    plane_2 = uvec4(0u);
    plane_3 = uvec4(0u);
    plane_4 = uvec4(0u);
    if (corner == 0u) {
        PeelPlane plane = Planes(push.planes + 72ul * uint64_t(part_number)).at[0];
        plane_0 = bits_of(plane.base, plane.c0);
        plane_1 = bits_of(plane.cu, plane.cv);
        plane_2 = bits_of(plane.d0, plane.du);
        plane_3 = bits_of(plane.dv, plane.lo);
        plane_4 = uvec4(unpackDouble2x32(plane.hi), part_number, object & ~kPeelJudged);
    }
}
