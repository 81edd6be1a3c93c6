#include "measure/fit.hpp"

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>
#include <numbers>

#include "measure/statistics.hpp"

#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wconversion"
#pragma GCC diagnostic ignored "-Wsign-conversion"
#include <boost/math/distributions/students_t.hpp>
#include <ceres/ceres.h>
#pragma GCC diagnostic pop

namespace pellucid {
namespace {

enum class CountKind { fixed, poisson };

/// 1 − (1 − a·ratio/cos^p)^n, or its Poisson limit, over the point's tilts. False where a·ratio/cos^p is
/// no probability below 1: outside the theory.
template <class T>
bool model_opacity(const OpacityPoint& point, CountKind kind, const T& area, const T& exponent, T& alpha) {
    using std::exp;
    using std::expm1;
    using std::log;
    using std::log1p;
    const RingPart whole{1.0, point.cos_tilt};
    const std::span<const RingPart> parts =
        point.ring.empty() ? std::span(&whole, 1) : std::span<const RingPart>(point.ring);
    alpha = T(0.0);
    for (const RingPart& part : parts) {
        const T landing = area * point.ratio * exp(-exponent * std::log(part.cos_tilt));
        if (!(landing > T(0.0)) || (kind == CountKind::fixed && !(landing < T(1.0)))) return false;
        const T depth = kind == CountKind::fixed ? T(-log1p(-landing)) : landing;
        alpha -= part.weight * expm1(-point.count * depth);  // PBSR (1)
    }
    return true;
}

bool is_cosine(double c) { return c > 0 && c <= 1; }

/// Whether the theory and the variance let this point say anything; see fit_opacity.
bool informative(const OpacityPoint& point) {
    const bool numbers = point.count > 0 && std::isfinite(point.count) && point.ratio > 0 &&
                         std::isfinite(point.alpha_drawn) && point.alpha_variance > 0 &&
                         std::isfinite(point.alpha_variance);
    const bool tilts = point.ring.empty()
                           ? is_cosine(point.cos_tilt)
                           : std::all_of(point.ring.begin(), point.ring.end(), [](const RingPart& part) {
                                 return part.weight > 0 && is_cosine(part.cos_tilt);
                             });
    double alpha = 0;
    return numbers && tilts && model_opacity(point, CountKind::fixed, 1.0, 1.0, alpha) && alpha > 0 && alpha < 1;
}

/// Residual of one point; the parameters are those that are free.
struct OpacityResidual {
    const OpacityPoint* point;
    OpacityModel model;
    CountKind kind;

    template <class T>
    bool operator()(const T* const parameters, T* residual) const {
        const T one(1.0);
        const T& area = model == OpacityModel::tilt_exponent ? one : parameters[0];
        const T& exponent = model == OpacityModel::effective_area ? one
                            : model == OpacityModel::both         ? parameters[1]
                                                                  : parameters[0];
        T alpha;
        if (!model_opacity(*point, kind, area, exponent, alpha)) return false;
        residual[0] = (alpha - point->alpha_drawn) / std::sqrt(point->alpha_variance);
        return true;
    }
};

struct LineResidual {
    double x;
    double y;
    double sigma;

    template <class T>
    bool operator()(const T* const parameters, T* residual) const {
        residual[0] = (parameters[0] * x + parameters[1] - y) / sigma;
        return true;
    }
};

/// (JᵀJ)⁻¹ of one or two parameters; empty where the points cannot tell them apart. Written out, because
/// the library's own covariance reports a singular matrix on stderr.
std::vector<double> covariance_at_minimum(ceres::Problem& problem, std::size_t parameters) {
    ceres::CRSMatrix jacobian;
    problem.Evaluate({}, nullptr, nullptr, nullptr, &jacobian);
    std::array<double, 3> h{};  // JᵀJ: h00, h01, h11
    for (std::size_t row = 0; row < static_cast<std::size_t>(jacobian.num_rows); ++row) {
        const double* j = &jacobian.values[row * parameters];  // dense rows: every residual has all parameters
        h[0] += j[0] * j[0];
        if (parameters < 2) continue;
        h[1] += j[0] * j[1];
        h[2] += j[1] * j[1];
    }
    if (parameters == 1) {
        if (h[0] > 0 && std::isfinite(1 / h[0])) return {1 / h[0]};
        return {};
    }
    constexpr double kSingular = 1e-12;  // 1 − correlation²: below it rounding decides the inverse
    const double det = h[0] * h[2] - h[1] * h[1];
    if (!(det > kSingular * h[0] * h[2])) return {};
    return {h[2] / det, -h[1] / det, -h[1] / det, h[0] / det};
}

/// Minimises and reads values, covariance and χ². `parameters` start at their first guess.
FitResult solve(ceres::Problem& problem, std::vector<double>& parameters, std::vector<std::string> names, double level) {
    FitResult result;
    result.used = static_cast<std::size_t>(problem.NumResiduals());
    result.dof = static_cast<double>(result.used) - static_cast<double>(parameters.size());
    if (result.dof < 0) return result;

    ceres::Solver::Options options;
    options.linear_solver_type = ceres::DENSE_QR;
    options.num_threads = 1;
    options.max_num_iterations = 200;
    options.function_tolerance = 1e-14;  // the minimum to well below a standard error
    options.parameter_tolerance = 1e-12;
    options.gradient_tolerance = 1e-14;
    options.logging_type = ceres::SILENT;
    ceres::Solver::Summary summary;
    ceres::Solve(options, &problem, &summary);
    if (!summary.IsSolutionUsable() || summary.termination_type != ceres::CONVERGENCE) return result;

    result.covariance = covariance_at_minimum(problem, parameters.size());
    if (result.covariance.empty()) return result;

    const double z = normal_critical_value(1 - level);
    for (std::size_t i = 0; i < parameters.size(); ++i) {
        const double error = std::sqrt(result.covariance[i * parameters.size() + i]);
        result.parameters.push_back(
            {std::move(names[i]), parameters[i], error, parameters[i] - z * error, parameters[i] + z * error});
    }
    result.chi2 = 2 * summary.final_cost;
    result.p_value = result.dof > 0 ? chi2_survival(result.chi2, result.dof) : 1.0;
    result.converged = true;
    return result;
}

FitResult fit_law(std::span<const OpacityPoint> points, OpacityModel model, CountKind kind, double level) {
    assert(level > 0 && level < 1);
    const bool both = model == OpacityModel::both;
    std::vector<double> parameters(both ? 2 : 1, 1.0);
    std::vector<std::string> names;
    if (model != OpacityModel::tilt_exponent) names.emplace_back("a");
    if (model != OpacityModel::effective_area) names.emplace_back("p");

    ceres::Problem problem;
    std::size_t skipped = 0;
    for (const OpacityPoint& point : points) {
        if (!informative(point)) {
            ++skipped;
            continue;
        }
        auto* residual = new OpacityResidual{&point, model, kind};  // owned by the cost function, that by the problem
        ceres::CostFunction* cost = nullptr;
        if (both)
            cost = new ceres::AutoDiffCostFunction<OpacityResidual, 1, 2>(residual);
        else
            cost = new ceres::AutoDiffCostFunction<OpacityResidual, 1, 1>(residual);
        problem.AddResidualBlock(cost, nullptr, parameters.data());
    }
    FitResult result = solve(problem, parameters, std::move(names), level);
    result.skipped = skipped;
    return result;
}

/// χ² at a = p = 1 and the Gaussian constant Σ ln(2πσ²) of the points used.
struct TheoryFit {
    double chi2 = 0;
    double constant = 0;
    std::size_t used = 0;
};

TheoryFit theory_fit(std::span<const OpacityPoint> points, CountKind kind) {
    TheoryFit fit;
    for (const OpacityPoint& point : points) {
        double alpha = 0;
        if (!informative(point) || !model_opacity(point, kind, 1.0, 1.0, alpha)) continue;
        const double off = alpha - point.alpha_drawn;
        fit.chi2 += off * off / point.alpha_variance;
        fit.constant += std::log(2 * std::numbers::pi * point.alpha_variance);
        ++fit.used;
    }
    return fit;
}

CountLawComparison::Side law_side(std::span<const OpacityPoint> points, CountKind kind, double level) {
    const TheoryFit theory = theory_fit(points, kind);
    CountLawComparison::Side side;
    side.chi2_theory = theory.chi2;
    side.log_likelihood_theory = -0.5 * (theory.chi2 + theory.constant);
    side.free_area = fit_law(points, OpacityModel::effective_area, kind, level);
    side.log_likelihood_free = -0.5 * (side.free_area.chi2 + theory.constant);
    return side;
}

}  // namespace

FitResult fit_opacity(std::span<const OpacityPoint> points, OpacityModel model, double level) {
    return fit_law(points, model, CountKind::fixed, level);
}

FitResult test_opacity(std::span<const OpacityPoint> points) {
    const TheoryFit theory = theory_fit(points, CountKind::fixed);
    FitResult result;
    result.chi2 = theory.chi2;
    result.used = theory.used;
    result.skipped = points.size() - theory.used;
    result.dof = static_cast<double>(theory.used);
    result.converged = theory.used > 0;
    result.p_value = theory.used > 0 ? chi2_survival(theory.chi2, result.dof) : 1.0;
    return result;
}

std::optional<CountLawComparison> compare_count_laws(std::span<const OpacityPoint> points, double level) {
    CountLawComparison both{.binomial = law_side(points, CountKind::fixed, level),
                            .poisson = law_side(points, CountKind::poisson, level)};
    if (!both.binomial.free_area.converged || !both.poisson.free_area.converged) return std::nullopt;
    for (const OpacityPoint& point : points) {
        double fixed = 0;
        double poisson = 0;
        if (!informative(point) || !model_opacity(point, CountKind::fixed, 1.0, 1.0, fixed) ||
            !model_opacity(point, CountKind::poisson, 1.0, 1.0, poisson))
            continue;
        both.expected_delta_chi2 += (poisson - fixed) * (poisson - fixed) / point.alpha_variance;
    }
    both.delta_chi2_theory = both.poisson.chi2_theory - both.binomial.chi2_theory;
    both.delta_chi2_free = both.poisson.free_area.chi2 - both.binomial.free_area.chi2;

    // Akaike's criterion χ² + 2·(free parameters), weights exp(−Δ/2).
    const std::array<double, 4> criterion{both.binomial.chi2_theory, both.binomial.free_area.chi2 + 2,
                                          both.poisson.chi2_theory, both.poisson.free_area.chi2 + 2};
    const double best = *std::min_element(criterion.begin(), criterion.end());
    std::array<double, 4> weight{};
    std::transform(criterion.begin(), criterion.end(), weight.begin(),
                   [best](double c) { return std::exp(0.5 * (best - c)); });
    both.akaike_weight_binomial = (weight[0] + weight[1]) / (weight[0] + weight[1] + weight[2] + weight[3]);

    // Both laws have the same number of parameters: the penalty of the BIC cancels.
    both.log10_bayes_factor = both.delta_chi2_theory / (2 * std::numbers::ln10);
    both.log10_bayes_factor_free = both.delta_chi2_free / (2 * std::numbers::ln10);
    return both;
}

FitResult fit_power_law(std::span<const ErrorPoint> points, double level) {
    assert(level > 0 && level < 1);
    const auto positive = [](double x) { return x > 0 && std::isfinite(x); };
    const bool weighted =
        std::any_of(points.begin(), points.end(), [](const ErrorPoint& p) { return p.relative_error != 0; });

    ceres::Problem problem;
    std::vector<double> parameters{0.0, 0.0};
    std::size_t skipped = 0;
    for (const ErrorPoint& point : points) {
        if (!positive(point.repeats) || !positive(point.error) || (weighted && !positive(point.relative_error))) {
            ++skipped;
            continue;
        }
        auto* residual = new LineResidual{std::log(point.repeats), std::log(point.error),
                                          weighted ? point.relative_error : 1.0};
        problem.AddResidualBlock(new ceres::AutoDiffCostFunction<LineResidual, 1, 2>(residual), nullptr,
                                 parameters.data());
    }
    FitResult result = solve(problem, parameters, {"slope", "log_factor"}, level);
    result.skipped = skipped;
    if (weighted || !result.converged) return result;

    // Unknown errors: the scatter about the line is their measure.
    result.p_value = 1;
    if (result.dof <= 0) {
        result.converged = false;
        return result;
    }
    const double variance = result.chi2 / result.dof;
    const boost::math::students_t student(result.dof);
    const double t = boost::math::quantile(boost::math::complement(student, 0.5 * (1 - level)));
    for (double& c : result.covariance) c *= variance;
    for (FitParameter& parameter : result.parameters) {
        parameter.standard_error *= std::sqrt(variance);
        parameter.low = parameter.value - t * parameter.standard_error;
        parameter.high = parameter.value + t * parameter.standard_error;
    }
    return result;
}

}  // namespace pellucid
