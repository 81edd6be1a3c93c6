// Do opaque particles drawn by the rasteriser obey PBSR (1), α = 1 − (1 − s/S)^n, and its law of tilt?
// configs/opacity_vs_n.toml -> results/opacity_vs_n/ -> analysis/opacity_vs_n.py
#include <cmath>
#include <map>
#include <numbers>

#include "core/error.hpp"
#include "harness/experiment.hpp"
#include "study/opacity_report.hpp"
#include "measure/opacity_theory.hpp"

namespace {

using namespace pellucid;

struct Settings {
    std::vector<std::string> backends;
    std::vector<double> ratios, tilts_deg, ring_edges_deg;
    std::vector<std::int64_t> counts, repeats;
    std::vector<Projection> projections;
    std::vector<PatchShape> shapes;
    double row_particles, least_transmittance, family_level;
};

const std::map<std::string, PatchShape> kShapes{
    {"flat", PatchShape::flat}, {"sphere", PatchShape::sphere}, {"torus", PatchShape::torus}};
const std::map<std::string, Projection> kProjections{{"orthographic", Projection::orthographic},
                                                     {"perspective", Projection::perspective}};

template <class Enum>
std::vector<Enum> named(const ConfigTable& config, const std::string& key,
                        const std::map<std::string, Enum>& names) {
    std::vector<Enum> values;
    for (const std::string& text : config.texts(key, kRequired)) {
        if (!names.contains(text))
            throw config.error(key, fmt::format("holds \"{}\", which is not known", text));
        values.push_back(names.at(text));
    }
    return values;
}

Settings read_settings(const ConfigTable& config) {
    Settings s{
        .backends = config.texts("backends", kRequired),
        .ratios = config.numbers("ratios", kRequired, {.lo = 1e-8, .hi = 1, .hi_open = true}),
        .tilts_deg = config.numbers("tilts_deg", kRequired, {.lo = 0, .hi = 90, .hi_open = true}),
        .ring_edges_deg = config.numbers("ring_edges_deg", kRequired, within(0, 90), {.min = 2, .max = 100}),
        .counts = config.integers("counts", kRequired, {.lo = 1, .hi = 4'000'000'000}),
        .repeats = config.integers("repeats", kRequired, {.lo = 1, .hi = 1 << 24}),
        .projections = named(config, "projections", kProjections),
        .shapes = named(config, "shapes", kShapes),
        .row_particles = config.number("row_particles", kRequired, at_least(1)),
        .least_transmittance = config.number("least_transmittance", kRequired, within(0, 1)),
        .family_level = config.number("family_level", kRequired, strictly_within(0, 1)),
    };
    (void)config.integer("seed", 1, {.lo = 0});
    for (const std::string& backend : s.backends)
        if (backend != "cpu" && backend != "vulkan")
            throw config.error("backends",
                               fmt::format("holds \"{}\", expected \"cpu\", \"vulkan\"", backend));
    for (std::size_t i = 1; i < s.ring_edges_deg.size(); ++i)
        if (!(s.ring_edges_deg[i] > s.ring_edges_deg[i - 1]))
            throw config.error("ring_edges_deg", "does not rise");
    return s;
}

/// Every patch of the axes; curved ones have no tilt.
std::vector<PatchView> all_views(const Settings& s) {
    std::vector<PatchView> views;
    for (const PatchShape shape : s.shapes)
        for (const Projection projection : s.projections)
            for (const double ratio : s.ratios)
                for (const double tilt_deg : shape == PatchShape::flat ? s.tilts_deg : std::vector<double>{0})
                    views.push_back({shape, projection, ratio, tilt_deg});
    return views;
}

}  // namespace

int main(int argc, char** argv) {
    return run_experiment(
        argc, argv, {"opacity_vs_n", "Do opaque particles obey alpha = 1 - (1 - s/S)^n?"},
        [](Experiment& ex) {
            const Settings settings = ex.config(read_settings);
            OpacityReport report(ex, settings.family_level, ex.backends(settings.backends));
            const std::vector<PatchView> views = all_views(settings);
            const auto progress = ex.progress("patches", views.size());
            std::uint64_t row = 0;
            for (const PatchView& view : views) {
                std::optional<OpacityPatch> patch;
                std::optional<PreparedScene> scene;
                std::vector<LineSampler> samplers;
                std::vector<std::unique_ptr<ParticleDrawer>> drawers;
                if (const auto stage = ex.stage("patches");
                    (patch = make_opacity_patch(view, settings.ring_edges_deg))) {
                    scene = prepare(patch->scene);
                    samplers = make_samplers(*scene);
                    drawers = report.make_drawers(*scene);
                }
                for (const std::int64_t count : settings.counts)
                    for (const std::int64_t repeats : settings.repeats) {
                        const OpacityRow entry{view, count, repeats, derived_seed(ex.seed(), row++)};
                        if (!patch) {
                            report.outside_theory(entry);
                            continue;
                        }
                        const double cos_tilt = std::cos(view.tilt_deg * std::numbers::pi / 180);
                        const auto clear =
                            transmittance_from_count(static_cast<double>(count), {view.ratio, cos_tilt});
                        const bool measurable = clear.value_or(0) >= settings.least_transmittance &&
                                                static_cast<double>(count) * static_cast<double>(repeats) <=
                                                    settings.row_particles;
                        report.add(entry, *patch, *scene, samplers[0], drawers, measurable);
                    }
                progress->step();
            }
            report.finish(settings.ring_edges_deg);
        });
}
