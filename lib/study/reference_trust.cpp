#include "study/reference_trust.hpp"

#include <algorithm>
#include <cmath>
#include <optional>

#include "core/error.hpp"
#include "measure/statistics.hpp"
#include "study/trust_closed_form.hpp"
#include "study/trust_images.hpp"
#include "study/trust_meshes.hpp"
#include "study/trust_parity.hpp"
#include "study/trust_restart.hpp"
#include "study/trust_roots.hpp"

namespace pellucid {
namespace {

constexpr IntegerRange kCounts{.lo = 1, .hi = 1'000'000'000'000};

/// Streams of seeds, one a topic.
enum class Topic : std::uint64_t {
    parity = 1,
    closed_form,
    grazing,
    stated_error,
    particle_filter,
    coincident,
    restart,
    roots
};

Seed seed_of(const Experiment& ex, Topic topic, std::uint64_t row) {
    return derived_seed(derived_seed(ex.seed(), static_cast<std::uint64_t>(topic)), row);
}

/// A mesh of which rays are counted, in a scene of its own.
struct MeshScene {
    std::string name;
    bool by_formula = true;
    Placement placement;
    PreparedScene scene;
};

const TriangleMesh& mesh_of(const PreparedScene& scene) {
    return *scene.objects[0].geometry->mesh();
}

std::vector<NamedMesh> formula_meshes() {
    return {{"icosphere", icosphere(4)},
            {"torus", torus_grid(96, 48)},
            {"cube", cube_mesh()},
            {"needle", sliver_prism(5, 1e-3)},
            {"plates", thin_plates(4, 1e-3)}};
}

/// Random lines may miss by what float32 moves them, at most 2^-22 of the radius (origin, direction and
/// vertex are each rounded at 2^-25 of it, the edge tests let pass 2^-23 of a triangle's height), and only
/// along silhouettes: strips of twice that width on either side of outlines that are together no longer than
/// 20 radii, in a disc of area π.
constexpr double kSilhouetteShare = 2 * 20 * 0x1p-22 / 3.14159265358979323846;

}  // namespace

ParitySettings read_parity_settings(const ConfigTable& t) {
    return {.mesh_folder = t.file("mesh_folder"),
            .files = t.texts("files", kRequired, {.min = 0}),
            .scales = t.numbers("scales", kRequired, above(0)),
            .offsets = t.numbers("offsets", kRequired, at_least(0)),
            .random_rays = static_cast<std::uint64_t>(t.integer("random_rays", kRequired, kCounts)),
            .aimed_rays = static_cast<std::uint64_t>(t.integer("aimed_rays", kRequired, kCounts)),
            .checked_rays = static_cast<std::uint64_t>(t.integer("checked_rays", kRequired, kCounts))};
}

void report_parity(Experiment& ex, const ParitySettings& s) {
    const auto stage = ex.stage("parity");
    CsvWriter& csv = ex.csv(
        "parity", {"mesh", "triangles", "scale", "offset_sizes", "aim", "rays", "hits", "odd_rays",
                   "odd_with_too_few", "odd_per_1e9", "odd_per_1e9_lo", "odd_per_1e9_hi",
                   "odd_per_1e9_expected", "checked_rays", "lost_rays", "doubled_rays", "swapped_rays"});
    const TemporaryFolder folder;
    std::vector<MeshScene> scenes;
    for (const NamedMesh& m : formula_meshes()) {
        const auto file = folder.path() / (m.name + ".off");
        write_off(file, m.mesh);
        for (const double scale : s.scales)
            for (const double offset : s.offsets) {
                const Placement placement{scale, offset * normalize(Vec3(3, -2, 6))};
                scenes.push_back({m.name, true, placement, mesh_for_lines(file, placement)});
            }
    }
    for (const std::string& name : s.files) {
        const auto file = s.mesh_folder / name;
        if (!std::filesystem::exists(file)) {
            warn("parity: {} is not there and left out", file.string());
            continue;
        }
        PreparedScene scene = mesh_for_lines(file, {});
        if (is_closed(mesh_of(scene)))
            scenes.push_back({file.stem().string(), false, {}, std::move(scene)});
        else
            warn("parity: {} is not closed and left out", file.string());
    }

    ParityCount by_formula, all;  // of random rays
    const auto progress = ex.progress("parity", scenes.size());
    std::uint64_t row = 0;
    for (const MeshScene& m : scenes) {
        const LineShooter shooter(m.scene);
        const TriangleMesh& mesh = mesh_of(m.scene);
        const Gather gather = [&](auto rays, auto& hits) { shooter.gather(rays, hits); };
        for (const Aim aim : kAims) {
            const std::uint64_t rays = aim == Aim::random ? s.random_rays : s.aimed_rays;
            const ParityCount count =
                count_parity(mesh, shooter, gather,
                             {aim, rays, std::min(rays, s.checked_rays), seed_of(ex, Topic::parity, row++)});
            const double per_1e9 = 1e9 / static_cast<double>(count.rays);
            const CountBounds bounds = poisson_bounds(static_cast<double>(count.odd));
            const std::string expected =
                aim == Aim::random ? csv_cell(kExtraPerHit * static_cast<double>(count.hits) * per_1e9) : "";
            csv.row(m.name, mesh.triangles.size(), m.placement.scale, length(m.placement.offset),
                    name_of(aim), count.rays, count.hits, count.odd, count.odd_short,
                    per_1e9 * static_cast<double>(count.odd), per_1e9 * bounds.lo, per_1e9 * bounds.hi,
                    expected, count.checked, count.lost, count.doubled, count.swapped);
            if (aim != Aim::random) continue;
            all += count;
            if (m.by_formula) by_formula += count;
        }
        progress->step();
    }
    const double level = 1 - sidak_level(kTrustLevel, 3);
    ex.check("random rays: odd numbers of hits per hit, lower bound, against Embree's tolerance",
             poisson_bounds(static_cast<double>(all.odd), level).lo / static_cast<double>(all.hits),
             "<=", kExtraPerHit);
    // A hit is lost at an outline alone: the front's tolerance may reach beyond it and the back's not, or the
    // other way.
    ex.check("random rays: share with an odd number of hits, one too few, lower bound, against outlines",
             poisson_bounds(static_cast<double>(all.odd_short), level).lo / static_cast<double>(all.rays),
             "<=", kSilhouetteShare);
    ex.check(
        "random rays, meshes by formula: share that differs from exact arithmetic, lower bound, against "
        "silhouettes",
        poisson_bounds(static_cast<double>(by_formula.lost + by_formula.doubled), level).lo /
            static_cast<double>(by_formula.checked),
        "<=", kSilhouetteShare);
}

ClosedFormSettings read_closed_form_settings(const ConfigTable& t) {
    return {.scales = t.numbers("scales", kRequired, above(0)),
            .offsets = t.numbers("offsets", kRequired, at_least(0)),
            .distances = t.numbers("distances", kRequired, at_least(2)),
            .rays = static_cast<std::uint64_t>(t.integer("rays", kRequired, kCounts)),
            .grazing_deltas = t.numbers("grazing_deltas", kRequired, within(0, 0.5)),
            .grazing_offsets = t.numbers("grazing_offsets", kRequired, at_least(0)),
            .grazing_rays = static_cast<std::uint64_t>(t.integer("grazing_rays", kRequired, kCounts))};
}

void report_closed_form(Experiment& ex, const ClosedFormSettings& s) {
    const auto stage = ex.stage("closed form");
    CsvWriter& csv = ex.csv(
        "closed_form", {"shape", "projection", "scale", "offset_sizes", "distance_sizes", "rays", "hits",
                        "borderline_rays", "wrong_rays", "worst_units", "rms_units", "worst_error_sizes"});
    double worst = 0;
    std::uint64_t wrong = 0, rays = 0, borderline = 0, row = 0;
    for (const TrustShape shape : kTrustShapes)
        for (const Projection projection : {Projection::perspective, Projection::orthographic})
            for (const double scale : s.scales)
                for (const double offset : s.offsets)
                    for (const double distance : s.distances) {
                        const ClosedFormResult r =
                            measure_closed_form({shape, scale, offset, distance, projection}, s.rays,
                                                seed_of(ex, Topic::closed_form, row++));
                        csv.row(name_of(shape),
                                projection == Projection::perspective ? "perspective" : "orthographic", scale,
                                offset, distance, r.rays, r.hits, r.borderline, r.wrong, r.worst_units,
                                r.rms_units, r.worst_error);
                        worst = std::max(worst, r.worst_units);
                        wrong += r.wrong;
                        rays += r.rays;
                        borderline += r.borderline;
                    }
    ex.check("closed form: rays with a wrong number of hits", static_cast<double>(wrong), "==", 0);
    ex.check("closed form: largest error of a depth, in units of its conditioning", worst, "<=", kDepthUnits);
    ex.check("closed form: share of rays too close to a tangent or rim to tell",
             static_cast<double>(borderline) / static_cast<double>(rays), "<", 0.01);
}

void report_grazing(Experiment& ex, const ClosedFormSettings& s) {
    const auto stage = ex.stage("grazing");
    CsvWriter& csv = ex.csv("grazing", {"offset_radii", "side", "delta", "resolution", "rays", "found_two",
                                        "exact_two", "wrong_rays", "intended_rays"});
    std::uint64_t wrong = 0, row = 0;
    for (const double offset : s.grazing_offsets)
        for (const double side : {-1.0, 1.0})
            for (const double delta : s.grazing_deltas) {
                const GrazingResult r =
                    measure_grazing(side * delta, offset, s.grazing_rays, seed_of(ex, Topic::grazing, row++));
                csv.row(offset, side < 0 ? "inside" : "outside", delta, grazing_resolution(offset), r.rays,
                        r.found_two, r.exact_two, r.wrong, r.intended);
                if (delta >= grazing_resolution(offset)) wrong += r.wrong;
            }
    ex.check("grazing: rays told wrongly above the rounding of the ray", static_cast<double>(wrong), "==", 0);
}

RootSettings read_root_settings(const ConfigTable& t) {
    return {.lines = static_cast<std::uint64_t>(t.integer("lines", kRequired, kCounts)),
            .checked = static_cast<std::uint64_t>(t.integer("checked", kRequired, kCounts))};
}

void report_roots(Experiment& ex, const RootSettings& s) {
    const auto stage = ex.stage("roots");
    CsvWriter& csv = ex.csv(
        "roots",
        {"surface",        "degree",           "lines_kind",         "finder",       "lines",
         "roots",          "lines_with_0",     "lines_with_1",       "lines_with_2", "lines_with_3",
         "lines_with_4",   "lines_with_5",     "lines_with_6",       "above_degree", "asymmetric_lines",
         "checked_lines",  "mismatched_lines", "wrong_parity_lines", "touching",     "undecided",
         "exact_intervals"});
    RootCounts right, traced, twin;  // sums of what must be 0
    std::uint64_t row = 0;
    const auto add = [](RootCounts& sum, const RootCounts& more) {
        sum.above_degree += more.above_degree;
        sum.asymmetric += more.asymmetric;
        sum.mismatched += more.mismatched;
        sum.wrong_parity += more.wrong_parity;
        sum.stats += more.stats;
    };
    for (const AlgebraicSurface& surface : algebraic_surfaces())
        for (const RootAim aim : {RootAim::random, RootAim::center}) {
            const Seed seed = seed_of(ex, Topic::roots, row++);
            const auto measure = [&](const char* finder, const FindRoots& find, std::uint64_t lines) {
                const RootCounts c = count_roots(surface, find, aim, lines, std::min(lines, s.checked), seed);
                const auto& with = c.lines_with;
                csv.row(surface.name, surface.degree, aim == RootAim::random ? "random" : "centre", finder,
                        c.lines, c.roots, with[0], with[1], with[2], with[3], with[4], with[5], with[6],
                        c.above_degree, c.asymmetric, c.checked, c.mismatched, c.wrong_parity,
                        c.stats.touching, c.stats.undecided, c.stats.exact);
                return c;
            };
            add(right, measure("certified", certified_roots(surface), s.lines));
            // Lines through the centre are aimed at a corner of cells, as rays at a vertex: counted, not
            // judged.
            const RootCounts seen = measure("traced", traced_roots(surface), std::min(s.lines, s.checked));
            if (aim == RootAim::random) add(traced, seen);
            add(twin, measure("16 samples", sampled_roots(surface, 16), std::min(s.lines, s.checked)));
        }
    // On a line that lies on the surface f is 0 all along: no roots, and nothing left open.
    const AlgebraicSurface& clebsch = algebraic_surfaces()[1];
    const FindRoots find = certified_roots(clebsch);
    std::vector<Root> on_it;
    std::uint64_t off_it = 0;
    for (const RootLine& line : lines_on_clebsch()) {
        find(line, on_it, right.stats);
        off_it += exact_count(clebsch, line).roots == -1 ? 0U : 1U;
    }
    ex.check("roots: lines whose count differs from Sturm's theorem", static_cast<double>(right.mismatched),
             "==", 0);
    ex.check("roots: lines whose parity differs from the signs at the ends",
             static_cast<double>(right.wrong_parity), "==", 0);
    ex.check("roots: lines with more than the degree (Bezout)", static_cast<double>(right.above_degree),
             "==", 0);
    ex.check("roots: lines through the centre whose roots are no pairs",
             static_cast<double>(right.asymmetric), "==", 0);
    ex.check("roots, traced as a surface: random lines whose count differs from Sturm's theorem",
             static_cast<double>(traced.mismatched), "==", 0);
    ex.check("roots: left undecided", static_cast<double>(right.stats.undecided), "==", 0);
    ex.check("roots: of the twelve lines on the Clebsch cubic, not on it", static_cast<double>(off_it),
             "==", 0);
    ex.check("roots: found on the lines that lie on it", static_cast<double>(on_it.size()), "==", 0);
    ex.check("roots, wrong twin, signs at 16 points: lines whose count differs",
             static_cast<double>(twin.mismatched), ">", 0);
}

ImageSettingsOfTrust read_image_settings(const ConfigTable& t) {
    const auto count = [&](const char* key, std::int64_t lo) {
        return t.integer(key, kRequired, {lo, 1 << 24});
    };
    return {.pixels = static_cast<int>(count("pixels", 2)),
            .seeds = static_cast<std::size_t>(count("seeds", 8)),
            .max_errors = t.numbers("max_errors", kRequired, above(0)),
            .max_samples = static_cast<int>(count("max_samples", 64)),
            .particle_pixels = static_cast<int>(count("particle_pixels", 8)),
            .repeats = static_cast<std::uint32_t>(count("repeats", 2)),
            .truth_error = t.number("truth_error", kRequired, above(0)),
            .truth_samples = static_cast<int>(count("truth_samples", 64)),
            .twin_error = t.number("twin_error", kRequired, above(0)),
            .coincident_pixels = static_cast<int>(count("coincident_pixels", 1))};
}

void report_stated_error(Experiment& ex, const ImageSettingsOfTrust& s) {
    const auto stage = ex.stage("stated error");
    CsvWriter& csv =
        ex.csv("stated_error", {"scene", "filter", "max_error", "seeds", "pixels", "stated_variance",
                                "floor_variance", "true_variance", "ratio", "ratio_error", "allowed_variance",
                                "rms_error", "worst_rms_error", "rays_per_pixel"});
    const TemporaryFolder folder;
    const std::vector<TrustScene> scenes = error_scenes(s.pixels, folder.path());
    const auto progress = ex.progress("stated errors", 2 * scenes.size() * (1 + s.max_errors.size()));
    const double critical = sidak_critical_value(kTrustLevel, 2 * static_cast<double>(scenes.size()));
    std::uint64_t row = 0;
    double twin_z = kInfinity, worst_z = 0, worst_share = 0;
    for (const TrustScene& scene : scenes)
        for (const PixelFilter filter : {PixelFilter::box, PixelFilter::particle}) {
            const char* filter_name = filter == PixelFilter::box ? "box" : "particle";
            const auto measure = [&](std::optional<double> max_error) {
                // Without an error to reach every pixel gets 64 sub-rays, and nothing is chosen by what was
                // seen.
                const StatedErrorPlan plan{.truth = {.filter = filter,
                                                     .max_error = max_error.value_or(1),
                                                     .max_samples = max_error ? s.max_samples : 64},
                                           .seeds = s.seeds,
                                           .seed = seed_of(ex, Topic::stated_error, row++)};
                const StatedError r = measure_stated_error(scene.scene, plan);
                csv.row(scene.name, filter_name, max_error ? csv_cell(*max_error) : "", r.seeds,
                        s.pixels * s.pixels, r.stated_variance, r.floor_variance, r.true_variance, r.ratio,
                        r.ratio_error, max_error ? csv_cell(r.allowed_variance) : "", r.rms, r.worst_rms,
                        r.rays_per_pixel);
                progress->step();
                return r;
            };
            const StatedError fixed = measure(std::nullopt);
            if (!scene.heavy_tailed) {
                worst_z = std::max(worst_z, std::abs(fixed.ratio - 1) / fixed.ratio_error);
                twin_z = std::min(twin_z, std::abs(0.5 * fixed.ratio - 1) / (0.5 * fixed.ratio_error));
            }
            for (const double max_error : s.max_errors) {
                const StatedError r = measure(max_error);
                if (!scene.heavy_tailed)
                    worst_share = std::max(worst_share, r.true_variance / r.allowed_variance);
            }
        }
    ex.check("stated error, 64 sub-rays a pixel: largest |stated/true variance - 1|, in its standard errors",
             worst_z, "<=", critical);
    ex.check("stated error, wrong twin, half the variance stated: least of the same", twin_z, ">", critical);
    ex.check("asked error: largest true variance over max(stated, asked)", worst_share, "<=", 1);
}

void report_particle_filter(Experiment& ex, const ImageSettingsOfTrust& s) {
    const auto stage = ex.stage("particle filter");
    CsvWriter& csv =
        ex.csv("particle_filter",
               {"scene", "truth", "repeats", "pixels_tested", "pixels_left_out", "worst_z", "worst_z_limit",
                "smallest_p", "color_ratio", "color_p", "drawn_where_nothing_is", "smallest_error_seen"});
    const std::vector<TrustScene> scenes = particle_scenes(s.particle_pixels);
    const double level = sidak_level(kTrustLevel, 4 * static_cast<double>(scenes.size()));
    std::uint64_t row = 0;
    for (const TrustScene& scene : scenes) {
        ParticlePlan right{.repeats = s.repeats, .seed = seed_of(ex, Topic::particle_filter, row++)};
        right.truth.max_error = s.truth_error;
        right.truth.max_samples = s.truth_samples;
        ParticlePlan box = right;
        box.truth.filter = PixelFilter::box;
        ParticlePlan off = right;
        off.optical_depth_error = s.twin_error;
        const auto judge = [&](const char* name, const ParticlePlan& plan) {
            const ParticleVerdict v = judge_particles(scene.scene, plan);
            const double limit = sidak_critical_value(
                kTrustLevel, static_cast<double>(std::max<std::size_t>(1, v.pixels) * scenes.size()));
            const bool colors = v.color_ratio > 0;
            csv.row(scene.name, name, plan.repeats, v.pixels, v.left_out, v.worst_z, limit, v.smallest_p,
                    colors ? std::optional(v.color_ratio) : std::nullopt,
                    colors ? std::optional(v.color_p) : std::nullopt, v.drawn_where_nothing_is,
                    v.smallest_error_seen);
            return std::pair{v, limit};
        };
        const auto [v, limit] = judge("particle filter", right);
        const std::string title = "particles, " + scene.name + ": ";
        ex.check(title + "largest |z| of a pixel", v.worst_z, "<=", limit);
        ex.check(title + "least p of their law", v.smallest_p, ">=", level);
        ex.check(title + "colour over noise floor: p", v.color_p, ">=", level);
        ex.check(title + "pixels drawn where nothing is", v.drawn_where_nothing_is, "==", 0);
        ex.check(title + "wrong twin, box filter: p", judge("twin: box filter", box).first.smallest_p, "<",
                 level);
        ex.check(title + "wrong twin, optical depth off: p",
                 judge("twin: optical depth off", off).first.smallest_p, "<", level);
    }
}

void report_coincident(Experiment& ex, const ImageSettingsOfTrust& s) {
    const auto stage = ex.stage("coincident");
    CsvWriter& csv = ex.csv(
        "coincident", {"kind", "layers", "orders", "pixels", "worst_ulps", "worst_difference_from_theory"});
    const TemporaryFolder folder;
    double ulps = 0, theory = 0;
    for (const Coincidence kind : kCoincidences)
        for (const int layers : {2, 3, 4}) {
            const CoincidentResult r = measure_coincident(kind, layers, s.coincident_pixels, folder.path(),
                                                          seed_of(ex, Topic::coincident, 0));
            csv.row(r.name, r.layers, r.orders, r.pixels, r.worst_ulps, r.worst_theory);
            ulps = std::max(ulps, r.worst_ulps);
            theory = std::max(theory, r.worst_theory);
        }
    ex.check("coincident: largest difference between orders, in float32 ulps", ulps, "<=", 1);
    ex.check("coincident: largest difference from the mean over orders in depth, zSlab (4.4)", theory,
             "<=", 0x1p-24);
}

RestartSettings read_restart_settings(const ConfigTable& t) {
    return {.epsilons = t.numbers("epsilons", kRequired, strictly_within(0, 1)),
            .gaps = t.numbers("gaps", kRequired, strictly_within(0, 0.1)),
            .rays = static_cast<std::uint64_t>(t.integer("rays", kRequired, kCounts))};
}

void report_restart(Experiment& ex, const RestartSettings& s) {
    const auto stage = ex.stage("restart");
    CsvWriter& csv = ex.csv("restart", {"mesh", "collects", "epsilon_radii", "rays", "hits", "odd_rays",
                                        "lost_rays", "doubled_rays"});
    const TemporaryFolder folder;
    std::vector<NamedMesh> meshes{{"torus", torus_grid(96, 48)}, {"needle", sliver_prism(5, 1e-3)}};
    for (const double gap : s.gaps)
        meshes.push_back({fmt::format("plates {:.0e} apart", gap), thin_plates(4, gap)});
    ParityCount truth;
    std::vector<std::uint64_t> caught(s.epsilons.size());
    std::uint64_t row = 0;
    for (const NamedMesh& m : meshes) {
        const auto file = folder.path() / fmt::format("{}.off", row);
        write_off(file, m.mesh);
        const PreparedScene scene = mesh_for_lines(file, {});
        const LineShooter shooter(scene);
        const TriangleMesh& mesh = mesh_of(scene);
        const RestartScene twin(mesh);
        const ParityPlan plan{Aim::random, s.rays, s.rays, seed_of(ex, Topic::restart, row++)};
        const auto measure = [&](std::optional<double> epsilon) {
            const ParityCount c = count_parity(
                mesh, shooter,
                [&](auto rays, auto& hits) {
                    if (epsilon)
                        twin.gather(rays, *epsilon, hits);
                    else
                        shooter.gather(rays, hits);
                },
                plan);
            csv.row(m.name, epsilon ? "restarts" : "truth", epsilon, c.rays, c.hits, c.odd, c.lost,
                    c.doubled);
            return c;
        };
        truth += measure(std::nullopt);
        for (std::size_t i = 0; i < s.epsilons.size(); ++i) {
            const ParityCount c = measure(s.epsilons[i]);
            caught[i] += c.lost + c.doubled;
        }
    }
    const auto lower_share = [](std::uint64_t events, std::uint64_t rays) {
        return poisson_bounds(static_cast<double>(events), 1 - kTrustLevel).lo / static_cast<double>(rays);
    };
    ex.check("truth on the twin's rays: share with lost or doubled hits, lower bound",
             lower_share(truth.lost + truth.doubled, truth.checked), "<=", kSilhouetteShare);
    for (std::size_t i = 0; i < s.epsilons.size(); ++i)
        ex.check(fmt::format(
                     "twin caught, restart by {:.0e}: share of rays with lost or doubled hits, lower bound",
                     s.epsilons[i]),
                 lower_share(caught[i], truth.checked), ">", kSilhouetteShare);
}

}  // namespace pellucid
