// One volume along one ray in double: pre-integration as cpu/preintegration.cpp, steps as VolumeCaster.
layout(buffer_reference, scalar) readonly buffer PlainVolumes { PlainVolume at[]; };

struct PlainLook {
    double opacity;
    Vec3d color;  // associated
};

// ---- Pre-integration

struct Moments {
    double mean;
    double skew;
};
Moments moments_of(double a0, double a1) {
    precise double middle = -log1p_d(-0.5lf * (a0 + a1));
    precise double r = (a0 - a1) / (2.0lf - a0 - a1);
    precise double r2 = r * r;
    precise double mean, skew;
    if (abs(r) < 0.05lf) {
        mean = middle + r2 * (1.0lf / 6.0lf + r2 * (1.0lf / 20.0lf + r2 * (1.0lf / 42.0lf + r2 / 72.0lf)));
        skew = -0.5lf * r * (1.0lf / 3.0lf + r2 * (1.0lf / 15.0lf + r2 * (1.0lf / 35.0lf + r2 / 63.0lf)));
    } else {
        // Where one end has opacity 1, r = ±1 and the logarithm's factor is 0.
        double up = r > -1.0lf ? log1p_d(r) : 0.0lf;
        double down = r < 1.0lf ? log1p_d(-r) : 0.0lf;
        precise double whole = (1.0lf + r) * up - (1.0lf - r) * down;
        precise double odd = abs(r) < 1.0lf ? 0.5lf * (1.0lf - 1.0lf / r2) * (up - down) : 0.0lf;
        mean = middle - whole / (2.0lf * r) + 1.0lf;
        skew = -0.25lf * (odd + 1.0lf / r);
    }
    return Moments(mean, skew);
}

double front_weight(double depth) {
    precise double thin = -depth / 12.0lf;
    precise double thick = 1.0lf / depth - 1.0lf / expm1_d(depth) - 0.5lf;
    return depth < 0.01lf ? thin : thick;
}

// Front to back.
struct DepthSum {
    double depth;
    Vec3d color;
};
DepthSum sum_more(DepthSum s, double more, Vec3d straight) {
    precise double weight = (expm1_d(-s.depth) + 1.0lf) * -expm1_d(-more);
    precise double depth = s.depth + more;
    s.color = along3d(s.color, weight, straight);
    s.depth = depth;
    return s;
}

double piece_opacity(PlainPiece p, double value) {
    precise double a = p.opacity + (value - p.from) * p.opacity_slope;
    return clamp(a, 0.0lf, 1.0lf);
}
Vec3d piece_color(PlainPiece p, double value) {
    precise double x = value - p.from;
    return along3d(p.color, x, p.color_slope);
}

DepthSum sum_piece(DepthSum s, PlainPiece p, double from, double to, double steps) {
    if (p.opacity == 0.0lf && p.opacity_slope == 0.0lf) return s;
    double a0 = piece_opacity(p, from), a1 = piece_opacity(p, to);
    Vec3d c0 = piece_color(p, from);
    if (a0 >= 1.0lf && a1 >= 1.0lf) return sum_more(s, kFar, c0);
    Vec3d change = along3d(piece_color(p, to), -1.0lf, c0);
    double most = max(max(abs(change.x), abs(change.y)), abs(change.z));
    Moments whole = moments_of(a0, a1);
    precise double depth = whole.mean * steps;
    if (!(depth > 0.0lf)) return s;
    if (most == 0.0lf) return sum_more(s, depth, c0);
    precise double wished = ceil(6.0lf * sqrt(depth * most));
    int parts = a0 == a1 ? 1 : int(clamp(wished, 1.0lf, 64.0lf));
    for (int i = 0; i < parts; ++i) {
        precise double u0 = double(i) / double(parts), u1 = (double(i) + 1.0lf) / double(parts);
        precise double b0 = a0 + u0 * (a1 - a0), b1 = a0 + u1 * (a1 - a0);
        Moments m = whole;
        if (parts > 1) m = moments_of(b0, b1);
        if (!(m.mean > 0.0lf)) continue;
        precise double part = m.mean * steps / double(parts);
        precise double ratio = m.skew / m.mean + front_weight(part);
        double shift = clamp(ratio, -0.5lf, 0.5lf);
        precise double at = 0.5lf * (u0 + u1) + shift / double(parts);
        s = sum_more(s, part, along3d(c0, at, change));
    }
    return s;
}

uint plain_piece_of(PlainVolume v, double value, uint piece) {
    PlainPieces pieces = PlainPieces(v.pieces);
    while (piece + 1u < v.piece_count && value >= pieces.at[piece].end) ++piece;
    while (piece > 0u && value < pieces.at[piece - 1u].end) --piece;
    return piece;
}

// `piece` is that of `from` and becomes that of `to`.
PlainLook plain_preintegrate(PlainVolume v, double from, double to, double steps, inout uint piece) {
    PlainLook look = PlainLook(0.0lf, Vec3d(0.0lf, 0.0lf, 0.0lf));
    uint last = plain_piece_of(v, to, piece);
    if (!(steps > 0.0lf)) {
        piece = last;
        return look;
    }
    PlainPieces pieces = PlainPieces(v.pieces);
    DepthSum sum = DepthSum(0.0lf, Vec3d(0.0lf, 0.0lf, 0.0lf));
    bool rising = to > from, whole = piece == last;
    for (double at = from; sum.depth < kFar;) {
        PlainPiece p = pieces.at[piece];
        double end = to;
        if (piece != last) end = rising ? p.end : pieces.at[piece - 1u].end;
        precise double share = abs(end - at) / abs(to - from);
        precise double part = steps * share;
        if (whole)
            sum = sum_piece(sum, p, at, end, steps);
        else if (share > 0.0lf)
            sum = sum_piece(sum, p, at, end, part);
        if (piece == last) break;
        at = end;
        piece = rising ? piece + 1u : piece - 1u;
    }
    piece = last;
    return PlainLook(-expm1_d(-sum.depth), sum.color);
}

// ---- Steps

struct PlainWalk {
    PlainRay r;
    double t;
    double value;
    bool number;
    uint piece;
    int64_t k;
};

Sampled volume_value(PlainGrid g, Vec3d p) {
    if (uses(g, kNearest)) {
        ivec3 n = ivec3(floor(dvec3(p.x + 0.5lf, p.y + 0.5lf, p.z + 0.5lf)));
        float v = Floats(g.samples).at[uint(n.x) + uint(g.size_x) * (uint(n.y) + uint(g.size_y) * uint(n.z))];
        return Sampled(double(v), is_number(v));
    }
    CellPlace c = cell_place(g, p);
    if (uses(g, kCatmullRom)) {
        // By differences: where all samples are equal, exactly their value.
        double first = double(Floats(g.samples).at[c.first]);
        Sampled s = spline_at(g, c, first);
        precise double value = first + s.value;
        return Sampled(value, s.number);
    }
    Corners q = corners_at(g, c);
    // As TrilinearDifferences.
    precise double x = q.v[1] - q.v[0], y = q.v[2] - q.v[0], z = q.v[4] - q.v[0];
    precise double xy = (q.v[3] - q.v[2]) - x, xz = (q.v[5] - q.v[4]) - x, yz = (q.v[6] - q.v[4]) - y;
    precise double xyz = ((q.v[7] - q.v[6]) - (q.v[5] - q.v[4])) - xy;
    precise double value = q.v[0] + c.at.x * (x + c.at.y * (xy + c.at.z * xyz) + c.at.z * xz) +
                           c.at.y * (y + c.at.z * yz) + c.at.z * z;
    return Sampled(value, q.number);
}
Gradient volume_gradient(PlainGrid g, Vec3d p) {
    CellPlace c = cell_place(g, p);
    if (uses(g, kCatmullRom)) return spline_gradient(g, c, 0.0lf);
    Corners q = corners_at(g, c);
    precise double x = q.v[1] - q.v[0], y = q.v[2] - q.v[0], z = q.v[4] - q.v[0];
    precise double xy = (q.v[3] - q.v[2]) - x, xz = (q.v[5] - q.v[4]) - x, yz = (q.v[6] - q.v[4]) - y;
    precise double xyz = ((q.v[7] - q.v[6]) - (q.v[5] - q.v[4])) - xy;
    precise double gx = x + c.at.y * (xy + c.at.z * xyz) + c.at.z * xz;
    precise double gy = y + c.at.x * (xy + c.at.z * xyz) + c.at.z * yz;
    precise double gz = z + c.at.x * (xz + c.at.y * xyz) + c.at.y * yz;
    return Gradient(Vec3d(gx, gy, gz), q.number);
}

void look_at(inout PlainWalk w, PlainVolume v, double t) {
    w.t = t;
    Sampled s = volume_value(v.grid, clamped_index(v.grid, w.r.from, w.r.along, t));
    w.value = s.number ? s.value : 0.0lf;
    w.number = s.number;
    w.piece = plain_piece_of(v, w.value, w.piece);
}

PlainWalk plain_start(PlainVolume v, PlainRay ray) {
    PlainWalk w;
    w.r = ray;
    w.piece = 0u;
    w.k = int64_t(0);
    w.number = false;
    w.value = 0.0lf;
    w.t = ray.span.lo;
    if (ray.span.lo < ray.span.hi) {
        w.k = grid_sample_before(w.t, ray.dt);
        look_at(w, v, w.t);
    }
    return w;
}

bool plain_done(PlainWalk w) { return !(w.t < w.r.span.hi); }

void plain_skip(inout PlainWalk w, PlainVolume v) {
    double shift = uses(v.grid, kNearest) ? 0.5lf : 0.0lf;
    Vec3d from = Vec3d(w.r.from.x + shift, w.r.from.y + shift, w.r.from.z + shift);
    double end = empty_until(v.grid, from, w.r.along, w.t);
    if (end >= w.r.span.hi * (1.0lf + kRoom)) {
        w.t = w.r.span.hi;
        return;
    }
    int64_t k = sample_after_skip(w.k, end, w.r.dt);
    if (k == w.k) return;
    w.k = k;
    precise double t = double(k) * w.r.dt;
    w.t = t;
    if (!plain_done(w)) look_at(w, v, t);
}

// The next face of cells behind depth t; `end` where it is not before. By rounding it is at most the third.
double next_face(double end, double from, double along, double t) {
    if (along == 0.0lf) return end;
    double onwards = along > 0.0lf ? 1.0lf : -1.0lf;
    precise double where = from + t * along;
    double face = along > 0.0lf ? floor(where) : ceil(where);
    precise double first = (face - from) / along;
    precise double second = (face + onwards - from) / along;
    precise double third = (face + onwards + onwards - from) / along;
    double meet = first > t ? first : second > t ? second : third;
    return meet > t ? min(end, meet) : end;
}

// What lies between the last place and t.
Slab plain_advance(CastCamera camera, Lights lights, inout PlainWalk w, PlainVolume v, double t) {
    double begin = w.t;
    precise double steps = w.r.ray_length / v.opacity_step;
    PlainLook look = PlainLook(0.0lf, Vec3d(0.0lf, 0.0lf, 0.0lf));
    w.t = t;
    if (uses(v.grid, kNearest)) {
        // Cut where the ray passes from cell to cell: in each the value is constant.
        for (double at = begin; at < t && look.opacity < 1.0lf;) {
            double end = next_face(t, w.r.from.x + 0.5lf, w.r.along.x, at);
            end = next_face(end, w.r.from.y + 0.5lf, w.r.along.y, at);
            end = next_face(end, w.r.from.z + 0.5lf, w.r.along.z, at);
            precise double middle = 0.5lf * (at + end);
            Sampled s = volume_value(v.grid, clamped_index(v.grid, w.r.from, w.r.along, middle));
            if (s.number) {
                precise double length = steps * (end - at);
                w.piece = plain_piece_of(v, s.value, w.piece);
                PlainLook part = plain_preintegrate(v, s.value, s.value, length, w.piece);
                precise double clear = 1.0lf - look.opacity;
                precise double opacity = look.opacity + clear * part.opacity;
                look.color = along3d(look.color, clear, part.color);
                look.opacity = opacity;
            }
            at = end;
        }
        return slab_between(begin, t, look.opacity, look.color);
    }
    double front = w.value;
    bool front_number = w.number;
    uint piece = w.piece;
    look_at(w, v, t);
    precise double length = steps * (t - begin);
    if (front_number && w.number) look = plain_preintegrate(v, front, w.value, length, piece);
    if (kLit && v.grid.lit != 0u && look.opacity > 0.0lf) {
        precise double middle = 0.5lf * (begin + t);
        Gradient g = volume_gradient(v.grid, clamped_index(v.grid, w.r.from, w.r.along, middle));
        double largest = max(max(abs(g.value.x), abs(g.value.y)), abs(g.value.z));
        if (g.number && largest > 0.0lf) {
            precise dvec3 unit = dvec3(g.value.x / largest, g.value.y / largest, g.value.z / largest);
            Vec3d normal = carried_normal(v.grid, Vec3d(unit.x, unit.y, unit.z));
            if (dot3d(normal, normal) > 0.0lf) {
                precise dvec3 c = dvec3(look.color.x / look.opacity, look.color.y / look.opacity,
                                        look.color.z / look.opacity);
                Vec3d world = along3d(w.r.ray.origin, middle, w.r.ray.direction);
                look.color = scaled3d(look.opacity, shaded(camera, lights, v.grid, Vec3d(c.x, c.y, c.z),
                                                           world, Vec3d(-normal.x, -normal.y, -normal.z)));
            }
        }
    }
    return slab_between(begin, t, look.opacity, look.color);
}

// One step: to the next sample, or to the end.
Slab plain_step(CastCamera camera, Lights lights, inout PlainWalk w, PlainVolume v) {
    w.k = w.k + int64_t(1);
    precise double next = double(w.k) * w.r.dt;
    return plain_advance(camera, lights, w, v, min(next, w.r.span.hi));
}
