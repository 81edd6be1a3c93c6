// As mix_shared of cpu/multi_volume_caster.cpp: slabs that share an interval, mixed one after the other; in
// double.
struct Shared {
    uint count;
    dvec4 mixed;     // associated colour, opacity
    dvec4 sum;       // of both
    dvec3 weighted;  // Σ depth·straight colour
    dvec3 solid;     // of those with opacity 1
    double depths;
    double solids;
};
Shared no_shared() {
    return Shared(0u, dvec4(0.0lf), dvec4(0.0lf), dvec3(0.0lf), dvec3(0.0lf), 0.0lf, 0.0lf);
}
Shared share(Shared s, vec4 rgba) {
    precise dvec4 c = dvec4(rgba);
    if (c.a >= 1.0lf) {
        s.solids += 1.0lf;
        precise dvec3 solid = s.solid + c.rgb;
        s.solid = solid;
    } else if (c.a > 0.0lf) {
        precise double depth = -log1p_d(-c.a);
        precise double depths = s.depths + depth;
        precise dvec3 weighted = s.weighted + depth / c.a * c.rgb;
        s.depths = depths;
        s.weighted = weighted;
    }
    s.count += 1u;
    if (s.count == 1u) {
        s.mixed = c;
        s.sum = c;
        return s;
    }
    precise dvec4 sum = s.sum + c;
    precise dvec3 color =
        s.mixed.rgb + c.rgb - 0.5lf * (s.mixed.rgb * c.a + c.rgb * s.mixed.a);  // zSlab (4.4)
    precise double opacity = 1.0lf - (1.0lf - s.mixed.a) * (1.0lf - c.a);       // zSlab (4.1)
    s.sum = sum;
    s.mixed = dvec4(color, opacity);
    return s;
}
vec4 shared_color(Shared s, uint mixing) {
    precise dvec4 mixed = s.mixed;
    if (s.count > 1u && mixing == kMixNormalised) {
        precise dvec3 color = mixed.a / s.sum.a * s.sum.rgb;  // (4.3)
        mixed.rgb = s.sum.a > 0.0lf ? color : dvec3(0.0lf);
    }
    if (s.count > 1u && mixing == kMixExtinction) {
        precise dvec3 by_depth = mixed.a / s.depths * s.weighted;
        precise dvec3 by_number = s.solid / s.solids;
        mixed.rgb = s.solids > 0.0lf ? by_number : s.depths > 0.0lf ? by_depth : dvec3(0.0lf);
    }
    return vec4(mixed);
}
