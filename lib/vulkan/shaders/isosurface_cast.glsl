// The rays of some packets of pixels to one isosurface: where samples on the grid of steps change sides,
// refined by ten bisections; in double, as IsosurfaceCaster. An invocation is one ray; what it finds goes to
// take_crossing(t, opacity, associated colour), which alone writes and says whether it wants more. Include
// that first.

const int kBisections = 10;

double surface_value(PlainSurface s, PlainRay r, double t, out bool number) {
    CellPlace c = cell_place(s.grid, clamped_index(s.grid, r.from, r.along, t));
    if (uses(s.grid, kCatmullRom)) {
        Sampled v = spline_at(s.grid, c, s.isovalue);
        number = v.number;
        return v.value;
    }
    Corners q = corners_at(s.grid, c);
    number = q.number;
    precise double v[8];
    for (int i = 0; i < 8; ++i) v[i] = q.v[i] - s.isovalue;
    precise double x0 = (1.0lf - c.at.x) * v[0] + c.at.x * v[1], x1 = (1.0lf - c.at.x) * v[2] + c.at.x * v[3];
    precise double x2 = (1.0lf - c.at.x) * v[4] + c.at.x * v[5], x3 = (1.0lf - c.at.x) * v[6] + c.at.x * v[7];
    precise double y0 = (1.0lf - c.at.y) * x0 + c.at.y * x1, y1 = (1.0lf - c.at.y) * x2 + c.at.y * x3;
    precise double z = (1.0lf - c.at.z) * y0 + c.at.z * y1;
    return z;
}

Vec3d surface_gradient(PlainSurface s, PlainRay r, double t) {
    CellPlace c = cell_place(s.grid, clamped_index(s.grid, r.from, r.along, t));
    if (uses(s.grid, kCatmullRom)) return spline_gradient(s.grid, c, s.isovalue).value;
    Corners q = corners_at(s.grid, c);
    precise dvec3 low = 1.0lf - c.at;
    precise double dx[4], rows[4];
    for (int i = 0; i < 4; ++i) {
        precise double a = q.v[2 * i] - s.isovalue, b = q.v[2 * i + 1] - s.isovalue;
        dx[i] = b - a;
        rows[i] = low.x * a + c.at.x * b;
    }
    precise double gx = low.z * (low.y * dx[0] + c.at.y * dx[1]) + c.at.z * (low.y * dx[2] + c.at.y * dx[3]);
    precise double gy = low.z * (rows[1] - rows[0]) + c.at.z * (rows[3] - rows[2]);
    precise double gz = (low.y * rows[2] + c.at.y * rows[3]) - (low.y * rows[0] + c.at.y * rows[1]);
    return Vec3d(gx, gy, gz);
}

bool keeps(PlainSurface s, Vec3d world) {
    Planes planes = Planes(s.grid.planes);
    for (uint i = 0u; i < s.grid.plane_count; ++i)
        if (dot3d(planes.at[i].normal, world) > planes.at[i].offset) return false;
    if (s.has_bounds == 0u) return true;
    Vec3d p = place_point(s.to_object, world);
    return p.x >= s.bounds_lo.x && p.x <= s.bounds_hi.x && p.y >= s.bounds_lo.y && p.y <= s.bounds_hi.y &&
           p.z >= s.bounds_lo.z && p.z <= s.bounds_hi.z;
}

double crossing_opacity(PlainSurface s, double cosine) {
    if (s.oblique == 0u || s.opacity == 1.0lf) return s.opacity;
    precise double exponent = log1p_d(-s.opacity) / cosine;
    return -expm1_d(exponent);
}

// False where the ray's loops were cut.
bool find_crossings(CastCamera camera, Lights lights, PlainSurface s, PlainRay r) {
    if (!(r.span.lo < r.span.hi)) return true;
    int64_t k = grid_sample_before(r.span.lo, r.dt);
    double t = r.span.lo;
    bool here_number;
    double here = surface_value(s, r, t, here_number);
    bool ended = false;  // and not cut
    for (uint rounds = camera.most_rounds; rounds > 0u; --rounds) {
        if (!(t < r.span.hi)) {
            ended = true;
            break;
        }
        double end = empty_until(s.grid, r.from, r.along, t);
        if (end >= r.span.hi * (1.0lf + kRoom)) {
            ended = true;
            break;
        }
        int64_t next = sample_after_skip(k, end, r.dt);
        if (next > k) {
            k = next;
            precise double at_sample = double(k) * r.dt;
            t = at_sample;
            if (!(t < r.span.hi)) {
                ended = true;
                break;
            }
            here = surface_value(s, r, t, here_number);
        }
        double t0 = t, before = here;
        bool before_number = here_number;
        k = k + int64_t(1);
        precise double next_sample = double(k) * r.dt;
        t = min(next_sample, r.span.hi);
        here = surface_value(s, r, t, here_number);
        // What is on the surface counts as above, so that a sample on it is one crossing.
        if (!before_number || !here_number || (before >= 0.0lf) == (here >= 0.0lf)) continue;
        double lo = t0, hi = t;
        bool number;
        for (int i = 0; i < kBisections; ++i) {
            precise double middle = 0.5lf * (lo + hi);
            double v = surface_value(s, r, middle, number);
            if ((number && v >= 0.0lf) == (before >= 0.0lf))
                lo = middle;
            else
                hi = middle;
        }
        // The rest by a line.
        double at_lo = abs(surface_value(s, r, lo, number)), at_hi = abs(surface_value(s, r, hi, number));
        precise double by_line = lo + (hi - lo) * at_lo / (at_lo + at_hi);
        double at = at_lo + at_hi > 0.0lf ? by_line : hi;
        Vec3d world = along3d(r.ray.origin, at, r.ray.direction);
        if (!keeps(s, world)) continue;
        Vec3d normal = carried_normal(s.grid, surface_gradient(s, r, at));
        if (!(dot3d(normal, normal) > 0.0lf))
            normal = Vec3d(-r.ray.direction.x, -r.ray.direction.y, -r.ray.direction.z);
        double cosine = clamp(abs(dot3d(normalised(normal), normalised(r.ray.direction))), 1e-12lf, 1.0lf);
        double opacity = crossing_opacity(s, cosine);
        Vec3d color = s.color;
        if (kLit && s.grid.lit != 0u) color = shaded(camera, lights, s.grid, color, world, normal);
        if (!take_crossing(s, at, opacity, scaled3d(opacity, color)) || opacity >= 1.0lf) {
            ended = true;
            break;
        }
    }
    return ended;
}
