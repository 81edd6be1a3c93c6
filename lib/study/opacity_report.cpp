#include "study/opacity_report.hpp"

#include <algorithm>
#include <cmath>

#include <nlohmann/json.hpp>

namespace pellucid {
namespace {

using nlohmann::ordered_json;

[[nodiscard]] const char* name_of(PatchShape shape) {
    switch (shape) {
        case PatchShape::flat: return "flat";
        case PatchShape::sphere: return "sphere";
        case PatchShape::torus: return "torus";
    }
    return "";
}

[[nodiscard]] ordered_json to_json(const FitResult& fit) {
    ordered_json parameters = ordered_json::array();
    for (const FitParameter& p : fit.parameters)
        parameters.push_back({{"name", p.name}, {"value", p.value}, {"standard_error", p.standard_error},
                              {"low", p.low}, {"high", p.high}});
    return {{"parameters", parameters}, {"covariance", fit.covariance}, {"chi2", fit.chi2}, {"dof", fit.dof},
            {"p_value", fit.p_value},   {"points", fit.used},           {"points_skipped", fit.skipped},
            {"converged", fit.converged}};
}

/// Covered, and uncovered, pixels that a row's theory must expect for it to take part in the fits.
constexpr double kLeastEvents = 50;

/// Pixels that a number of repeats needs for a point of the error's slope.
constexpr std::size_t kLeastPixels = 100;

/// Statements about intervals that are made together: a; p; a and p jointly; the slope.
constexpr double kIntervals = 5;

}  // namespace

OpacityReport::OpacityReport(Experiment& experiment, double family_level, std::vector<Backend> backends)
    : experiment_(&experiment),
      family_level_(family_level),
      backends_(std::move(backends)),
      csv_(&experiment.csv(
          "opacity", {"backend", "shape", "projection", "ratio", "count", "tilt_deg", "theta_lo_deg",
                      "theta_hi_deg", "repeats", "pixels", "pixels_measured", "alpha_drawn", "alpha_theory",
                      "variance_drawn", "variance_theory", "z_score"})),
      twins_csv_(&experiment.csv("twins", {"twin", "alpha_drawn", "alpha_theory", "z_score", "z_critical",
                                           "z_score_without_fault", "rejected"})) {}

void OpacityReport::outside_theory(const OpacityRow& row) {
    for (const Backend& backend : backends_) write_row(row, backend, nullptr, nullptr, std::nullopt);
}

std::vector<std::unique_ptr<ParticleDrawer>> OpacityReport::make_drawers(const PreparedScene& scene) const {
    std::vector<std::unique_ptr<ParticleDrawer>> drawers;
    for (const Backend& backend : backends_) drawers.push_back(backend.make_particle_drawer(scene));
    return drawers;
}

void OpacityReport::add(const OpacityRow& row, const OpacityPatch& patch, const PreparedScene& scene,
                        const LineSampler& sampler, std::span<const std::unique_ptr<ParticleDrawer>> drawers,
                        bool measurable) {
    std::vector<PatchDraw> draws;
    if (measurable) {
        const auto stage = experiment_->stage("particles");
        draws = draw_patch(
            patch, scene, sampler, drawers,
            {static_cast<std::uint64_t>(row.count), static_cast<std::uint32_t>(row.repeats), row.seed});
        for (const PatchDraw& draw : draws) rows_different_ += draw.as_first ? 0U : 1U;
    }
    const auto stage = experiment_->stage("theory");
    for (std::size_t r = 0; r < patch.rings.size(); ++r) {
        const Ring& ring = patch.rings[r];
        std::optional<double> first_z;
        for (std::size_t b = 0; b < backends_.size(); ++b) {
            if (ring.members.empty() || !measurable) {
                write_row(row, backends_[b], &ring, nullptr, std::nullopt);
                continue;
            }
            // The same total has the same z: the exact law is computed once.
            const RingDraw& draw = draws[b].rings[r];
            const double z = first_z && draw.covered == draws[0].rings[r].covered
                                 ? *first_z
                                 : ring_z_score(ring, draw, static_cast<double>(row.count),
                                                static_cast<double>(row.repeats), derived_seed(row.seed, r));
            write_row(row, backends_[b], &ring, &draw, z);
            if (!first_z) keep(row, patch, ring, draw, z);
            if (!first_z) first_z = z;
        }
    }
}

/// Keeps what the fits and the tests of all rows together need.
void OpacityReport::keep(const OpacityRow& row, const OpacityPatch& patch, const Ring& ring,
                         const RingDraw& draw, double z) {
    const auto count = static_cast<double>(row.count);
    const auto repeats = static_cast<double>(row.repeats);
    z_scores_.push_back(z);
    // Least squares takes errors for Gaussian: rows of a few expected events stay with the exact tests.
    const CoveredShare theory = ring_theory(ring, count);
    const double throws = theory.pixels * repeats;
    if (std::min(theory.mean, theory.uncovered) * throws >= kLeastEvents)
        points_.push_back(fit_point(patch, ring, draw, count, repeats));
    RepeatError& error = errors_[row.repeats];
    error.squares += draw.squares;
    error.variance += draw.squares_variance;
    error.pixels += draw.informative;
}

void OpacityReport::write_row(const OpacityRow& row, const Backend& backend, const Ring* ring,
                              const RingDraw* draw, std::optional<double> z) {
    using Cell = std::optional<double>;
    const bool flat = row.view.shape == PatchShape::flat;
    const bool any = ring != nullptr && !ring->members.empty();
    const auto theory =
        any ? std::optional(ring_theory(*ring, static_cast<double>(row.count))) : std::nullopt;
    csv_->row(backend.name(), name_of(row.view.shape),
              row.view.projection == Projection::perspective ? "perspective" : "orthographic", row.view.ratio,
              row.count, flat ? Cell(row.view.tilt_deg) : Cell(), ring ? Cell(ring->theta_lo_deg) : Cell(),
              ring ? Cell(ring->theta_hi_deg) : Cell(), row.repeats, ring ? Cell(ring->pixels) : Cell(),
              ring ? ring->members.size() : 0, draw ? Cell(draw->alpha()) : Cell(),
              theory ? Cell(theory->mean) : Cell(),
              draw && row.repeats > 1 ? Cell(draw->share.variance()) : Cell(),
              theory ? Cell(theory->variance) : Cell(), z);
}

void OpacityReport::finish(const std::vector<double>& ring_edges_deg) {
    const double critical =
        sidak_critical_value(family_level_, static_cast<double>(std::max<std::size_t>(z_scores_.size(), 1)));
    double worst = 0;
    std::vector<double> uniform;
    for (const double z : z_scores_) {
        worst = std::max(worst, std::abs(z));
        uniform.push_back(normal_cdf(z));
    }
    experiment_->check(fmt::format("largest |z| of {} opacities", z_scores_.size()), worst, "<=", critical);
    if (const auto ks = ks_uniformity(uniform))
        experiment_->check("z-scores are standard normal: p of Kolmogorov-Smirnov", ks->p_value,
                           ">=", family_level_);
    if (backends_.size() > 1)
        experiment_->check("covered pixels equal on every backend: rows that differ",
                           static_cast<double>(rows_different_), "==", 0);
    check_fits();
    check_slope();
    check_twins(ring_edges_deg);
    experiment_->json("fit", fits_json_);
}

void OpacityReport::check_fits() {
    const auto stage = experiment_->stage("fits");
    const double level = 1 - sidak_level(family_level_, kIntervals);
    ordered_json json{{"interval_level", level},
                      {"z_critical", sidak_critical_value(family_level_, kIntervals)}};
    const std::pair<const char*, OpacityModel> models[] = {{"effective_area", OpacityModel::effective_area},
                                                           {"tilt_exponent", OpacityModel::tilt_exponent},
                                                           {"both", OpacityModel::both}};
    for (const auto& [name, model] : models) {
        const FitResult fit = fit_opacity(points_, model, level);
        json[name] = to_json(fit);
        // Too few points to tell (no tilt at all, say) is no answer, and no failure of the theory.
        if (!fit.converged) continue;
        for (const FitParameter& p : fit.parameters) {
            const double off = std::abs(p.value - 1) / p.standard_error;
            experiment_->check(fmt::format("fit {}: {} = {:.6f} +- {:.6f}, its interval holds 1", name,
                                           p.name, p.value, p.standard_error),
                               off, "<=", sidak_critical_value(family_level_, kIntervals));
            // What the fit would have seen with probability one half.
            if (model != OpacityModel::both)
                json[name]["smallest_bias_seen"] =
                    sidak_critical_value(family_level_, kIntervals) * p.standard_error;
        }
    }
    if (const auto laws = compare_count_laws(points_, level)) {
        json["binomial_against_poisson"] = {
            {"binomial",
             {{"chi2", laws->binomial.chi2_theory}, {"free_area", to_json(laws->binomial.free_area)}}},
            {"poisson",
             {{"chi2", laws->poisson.chi2_theory}, {"free_area", to_json(laws->poisson.free_area)}}},
            {"delta_chi2", laws->delta_chi2_theory},
            {"akaike_weight_binomial", laws->akaike_weight_binomial},
            {"log10_bayes_factor", laws->log10_bayes_factor},
            {"log10_bayes_factor_free_area", laws->log10_bayes_factor_free}};
        json["binomial_against_poisson"]["expected_delta_chi2"] = laws->expected_delta_chi2;
        // "Decisive" by Jeffreys' scale is 2, Δχ² = 9.2. Under the fixed number Δχ² ~ N(Δ, 4Δ) with Δ known
        // from theory: only from here on a right drawing misses it with a probability below 0.001.
        constexpr double kTellingChi2 = 56;
        if (laws->expected_delta_chi2 >= kTellingChi2)
            experiment_->check("binomial against Poisson: log10 of the Bayes factor",
                               laws->log10_bayes_factor, ">=", 2);
    }
    fits_json_ = json.dump(2) + "\n";
}

void OpacityReport::check_slope() {
    CsvWriter& csv =
        experiment_->csv("repeats", {"repeats", "pixels", "error", "error_standard_error", "error_theory"});
    std::vector<ErrorPoint> points;
    for (const auto& [repeats, e] : errors_) {
        if (e.pixels < kLeastPixels) continue;  // their mean square is no Gaussian
        const auto pixels = static_cast<double>(e.pixels);
        const double error = std::sqrt(e.squares / pixels);
        // Of the theory's error, not of the drawn one.
        const double relative = 0.5 * std::sqrt(e.variance) * static_cast<double>(repeats) / pixels;
        csv.row(repeats, e.pixels, error, error * relative, 1 / std::sqrt(static_cast<double>(repeats)));
        if (error > 0) points.push_back({static_cast<double>(repeats), error, relative});
    }
    const FitResult fit = fit_power_law(points, 1 - sidak_level(family_level_, kIntervals));
    auto json = ordered_json::parse(fits_json_);
    json["error_over_repeats"] = to_json(fit);
    fits_json_ = json.dump(2) + "\n";
    if (!fit.converged || points.size() < 2) return;
    const FitParameter& slope = fit.parameters[0];
    experiment_->check(fmt::format("error over repeats: slope = {:.5f} +- {:.5f}, its interval holds -1/2",
                                   slope.value, slope.standard_error),
                       std::abs(slope.value + 0.5) / slope.standard_error,
                       "<=", sidak_critical_value(family_level_, kIntervals));
}

void OpacityReport::check_twins(const std::vector<double>& edges) {
    const auto stage = experiment_->stage("wrong twins");
    const PatchView flat{PatchShape::flat, Projection::orthographic, 1e-4, 0};
    draw_twin("particles two pixels wide", flat, DrawTwin::two_pixels_wide, edges);
    draw_twin("repeats share one particle set", flat, DrawTwin::shared_set, edges);
    draw_close_sheets();
}

void OpacityReport::draw_twin(const std::string& name, const PatchView& view, DrawTwin twin,
                              const std::vector<double>& edges) {
    constexpr std::uint64_t kCount = 6931;  // α = ½ at s/S = 1e-4
    constexpr std::uint32_t kRepeats = 100;
    const auto patch = make_opacity_patch(view, edges);
    const PreparedScene scene = prepare(patch->scene);
    const auto samplers = make_samplers(scene);
    const std::unique_ptr<ParticleDrawer> drawer[] = {backends_[0].make_particle_drawer(scene)};
    const Ring& ring = patch->rings[0];
    const auto draw_once = [&](Seed seed, DrawTwin fault) {
        return draw_patch(*patch, scene, samplers[0], drawer, {kCount, kRepeats, seed, fault})[0].rings[0];
    };
    // A shared set is right on average and wrong in its variance: of 30 of them some is far off.
    RingDraw worst;
    double worst_z = 0;
    double worst_right = 0;
    for (std::uint64_t i = 0; i < 30; ++i) {
        const Seed seed = derived_seed(experiment_->seed(), 0x1000000 + i);
        const RingDraw draw = draw_once(seed, twin);
        const double z = ring_z_score(ring, draw, kCount, kRepeats, seed);
        const RingDraw right = draw_once(seed, DrawTwin::none);
        worst_right = std::max(worst_right, std::abs(ring_z_score(ring, right, kCount, kRepeats, seed)));
        if (std::abs(z) < std::abs(worst_z)) continue;
        worst_z = z;
        worst = draw;
        if (twin == DrawTwin::two_pixels_wide) break;
    }
    note_twin(name, worst.alpha(), ring_theory(ring, kCount).mean, worst_z, worst_right);
}

/// Two sheets of one surface, a tenth of a pixel apart, α = 0.3 each: 1 − 0.7² = 0.51.
void OpacityReport::draw_close_sheets() {
    constexpr int kSide = 64;
    constexpr std::uint32_t kRepeats = 100;
    Scene scene;
    scene.source = "two close sheets";
    scene.image = {.width = kSide, .height = kSide};
    scene.camera = {.projection = Projection::orthographic, .position = {0, 0, 1000}, .view_height = kSide};
    scene.lights.push_back({.headlight = true});
    Surface surface;
    surface.name = "sheets";
    // So flat an ellipsoid that its two sides are sheets all over the pixels that are looked at.
    constexpr double kRadius = 0.45 * kSide;
    surface.shape = ImplicitShape{"ellipsoid", {{"a", kRadius}, {"b", kRadius}, {"c", 0.05}}};
    surface.opacity = 0.3;
    surface.shading.flat = true;
    scene.surfaces.push_back(surface);
    const PreparedScene prepared = prepare(scene);
    const auto samplers = make_samplers(prepared);

    const double theory = 1 - 0.7 * 0.7;
    double z[2];
    double drawn[2];
    for (const bool fault : {false, true}) {
        const SamplerSettings settings{.seed = derived_seed(experiment_->seed(), 0x2000000),
                                       .exact_count = {},
                                       .keep_all_crossings = fault};
        const ParticleSet set = sample_particles(prepared, samplers, settings, 0, kRepeats);
        EnsembleSums sums = make_sums(prepared);
        backends_[0].make_particle_drawer(prepared)->draw(set, sums);
        double covered = 0;
        double trials = 0;
        for (int i = 0; i < kSide * kSide; ++i) {
            const double off = std::hypot(i % kSide + 0.5 - 0.5 * kSide, i / kSide + 0.5 - 0.5 * kSide);
            if (off > 0.8 * kRadius) continue;
            covered += sums.pixels[static_cast<std::size_t>(i)].covered;
            trials += kRepeats;
        }
        drawn[fault] = covered / trials;
        z[fault] = (covered - trials * theory) / std::sqrt(trials * theory * (1 - theory));
    }
    note_twin("all crossings of a line in one repeat, two close sheets", drawn[1], theory, z[1], z[0]);
}

void OpacityReport::note_twin(const std::string& name, double drawn, double theory, double z,
                              double z_of_right_one) {
    const double critical = sidak_critical_value(family_level_, 30);
    twins_csv_->row(name, drawn, theory, z, critical, z_of_right_one, std::abs(z) > critical);
    experiment_->check("wrong twin is rejected, |z|: " + name, std::abs(z), ">", critical);
    experiment_->check("the same without the fault is not, |z|: " + name, std::abs(z_of_right_one),
                       "<=", critical);
}

}  // namespace pellucid
