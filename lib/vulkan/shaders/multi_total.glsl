// What a ray of multi-volume casting leaves: its share of its pixel's total, and, with the last of its pixel,
// the pixel. No other ray of a dispatch has the same pixel.
layout(buffer_reference, scalar) buffer Totals { PixelTotal at[]; };
layout(buffer_reference, scalar) writeonly buffer Planes5 { uint at[]; };

struct Gathered {
    double clear;
    double r;
    double g;
    double b;
    double z;
};

void add_to_pixel(CastCamera camera, Totals totals, Planes5 planes, ivec2 pixel, uint part, Gathered sum) {
    uint n = uint(pixel.y * camera.width + pixel.x);
    PixelTotal t = PixelTotal(0.0lf, 0.0lf, 0.0lf, 0.0lf, kNoDepth);
    if (part > 0u) t = totals.at[n];
    precise dvec4 more = dvec4(t.r + sum.r, t.g + sum.g, t.b + sum.b, t.clear + sum.clear);
    t = PixelTotal(more.x, more.y, more.z, more.w, min(t.z, sum.z));
    totals.at[n] = t;
    if (part + 1u < camera.rays * camera.rays) return;
    precise double share = 1.0lf / double(camera.rays * camera.rays);
    precise dvec4 mean = dvec4(share * t.r, share * t.g, share * t.b, 1.0lf - share * t.clear);
    uint pixels = uint(camera.width * camera.height);
    for (uint c = 0u; c < 4u; ++c) planes.at[c * pixels + n] = floatBitsToUint(float(mean[c]));
    planes.at[4u * pixels + n] = t.z >= kNoDepth ? kInfinityBits : floatBitsToUint(float(t.z));
}
