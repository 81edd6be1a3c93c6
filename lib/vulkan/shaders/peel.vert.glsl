// A corner of a part. What the device's rasteriser covers as the CPU's does (it has 8 bits below the pixel) goes there as
// it is: corners within the viewport, w = 1, and no rounding from the grid to the pixel, since the viewport's side is a
// power of two. What reaches out of the viewport would be cut at places of the device's choice: in its stead comes a
// triangle over its pixels, and the fragment shader judges each (`judged`).
#version 460
#include "vulkan/shaders/peeling.glsl"

layout(push_constant, scalar) uniform Push { PeelDrawPush push; };

layout(location = 0) flat out uvec4 plane_0;  // the triangle's PeelPlane, by its bits
layout(location = 1) flat out uvec4 plane_1;
layout(location = 2) flat out uvec4 plane_2;
layout(location = 3) flat out uvec4 plane_3;
layout(location = 4) flat out uvec2 plane_4;
layout(location = 5) flat out uvec4 part_judged_object_triangle;

uvec4 bits_of(double a, double b) { return uvec4(unpackDouble2x32(a), unpackDouble2x32(b)); }

void main() {
    uint part_number = uint(gl_VertexIndex) / 3u;
    uint corner = uint(gl_VertexIndex) - 3u * part_number;
    PeelPart p = Parts(push.parts).at[part_number];
    int x_lo = min(min(p.x0, p.x1), p.x2);
    int x_hi = max(max(p.x0, p.x1), p.x2);
    int y_lo = min(min(p.y0, p.y1), p.y2);
    int y_hi = max(max(p.y0, p.y1), p.y2);
    int left = push.viewport_x * 256;
    int top = push.viewport_y * 256;
    int side = push.viewport_side * 256;
    bool whole = push.judge_all == 0 && x_lo >= left && y_lo >= top && x_hi <= left + side && y_hi <= top + side;
    int x = corner == 0 ? p.x0 : (corner == 1 ? p.x1 : p.x2);
    int y = corner == 0 ? p.y0 : (corner == 1 ? p.y1 : p.y2);
    if (!whole) {
        // Twice the rectangle and a pixel around it, cut to the rows at hand.
        int x_first = max(x_lo, 0) - 256;
        int y_first = max(y_lo, push.first_row * 256) - 256;
        int wide = 2 * (min(x_hi, push.width * 256) - x_first) + 1024;
        int high = 2 * (min(y_hi, (push.first_row + push.rows) * 256) - y_first) + 1024;
        x = x_first + (corner == 1 ? wide : 0);
        y = y_first + (corner == 2 ? high : 0);
    }
    float to_device = 2.0 / float(side);  // exact
    gl_Position = vec4((float(x - left) + push.shift) * to_device - 1.0, float(y - top) * to_device - 1.0, 0.5, 1.0);

    part_judged_object_triangle = uvec4(part_number, whole ? 0u : 1u, p.object, p.triangle);
    plane_0 = uvec4(0u);
    plane_1 = uvec4(0u);
    plane_2 = uvec4(0u);
    plane_3 = uvec4(0u);
    plane_4 = uvec2(0u);
    if (corner == 0u) {  // the one whose flat outputs count
        PeelPlane plane = Planes(push.planes).at[part_number];
        plane_0 = bits_of(plane.base, plane.c0);
        plane_1 = bits_of(plane.cu, plane.cv);
        plane_2 = bits_of(plane.d0, plane.du);
        plane_3 = bits_of(plane.dv, plane.lo);
        plane_4 = unpackDouble2x32(plane.hi);
    }
}
