#include "measure/transition_fit.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include "core/vec.hpp"

#pragma GCC diagnostic push
#pragma GCC diagnostic ignored "-Wconversion"
#pragma GCC diagnostic ignored "-Wsign-conversion"
#include <Eigen/Dense>
#include <boost/math/distributions/students_t.hpp>
#include <ceres/ceres.h>
#pragma GCC diagnostic pop

namespace pellucid {
namespace {

constexpr std::size_t kParameters = 3;  // center, log width, log exponent

template <class T>
T share_of(const T& x, const T& center, const T& width, const T& exponent) {
    using std::pow;
    const T u = (x - center) / width;
    const T size = u < T(0.0) ? T(-u) : u;
    if (!(size < T(1.0))) return T(u < T(0.0) ? 0.0 : 1.0);
    const T half = 0.5 * (1.0 - pow(1.0 - size, exponent));
    return u < T(0.0) ? T(0.5 - half) : T(0.5 + half);
}

struct Residual {
    TransitionPoint point;
    template <class T>
    bool operator()(const T* const p, T* residual) const {
        using std::exp;
        residual[0] = share_of(T(point.x), p[0], T(exp(p[1])), T(exp(p[2]))) - point.share;
        return true;
    }
};

[[nodiscard]] bool between(const TransitionPoint& p) { return p.share > 1e-6 && p.share < 1 - 1e-6; }

/// Where the share passes ½, and half of the way from 0 to 1; false for a step.
bool guess(std::span<const TransitionPoint> points, std::array<double, kParameters>& parameters) {
    double lo = kInfinity, hi = -kInfinity, middle = 0, nearest = kInfinity;
    std::size_t inside = 0;
    for (const TransitionPoint& p : points) {
        if (!between(p)) continue;
        ++inside;
        lo = std::min(lo, p.x);
        hi = std::max(hi, p.x);
        if (std::abs(p.share - 0.5) < nearest) {
            nearest = std::abs(p.share - 0.5);
            middle = p.x;
        }
    }
    if (inside <= kParameters || !(hi > lo)) return false;
    parameters = {middle, std::log(std::max(hi - middle, middle - lo) * 1.05), std::log(1.5)};
    return true;
}

}  // namespace

double transition_share(double x, double center, double width, double exponent) {
    return share_of(x, center, width, exponent);
}

FitResult fit_transition(std::span<const TransitionPoint> points, double level) {
    FitResult result;
    result.used = points.size();
    result.dof = static_cast<double>(points.size()) - static_cast<double>(kParameters);
    std::array<double, kParameters> p{};
    if (result.dof < 1 || !guess(points, p)) return result;

    ceres::Problem problem;
    for (const TransitionPoint& point : points)
        problem.AddResidualBlock(
            new ceres::AutoDiffCostFunction<Residual, 1, kParameters>(new Residual{point}), nullptr, p.data());
    ceres::Solver::Options options;
    options.linear_solver_type = ceres::DENSE_QR;
    options.num_threads = 1;
    options.max_num_iterations = 500;
    options.function_tolerance = 1e-14;
    options.parameter_tolerance = 1e-12;
    options.gradient_tolerance = 1e-14;
    options.logging_type = ceres::SILENT;
    ceres::Solver::Summary summary;
    ceres::Solve(options, &problem, &summary);
    if (!summary.IsSolutionUsable()) return result;

    double cost = 0;
    ceres::CRSMatrix jacobian;
    problem.Evaluate({}, &cost, nullptr, nullptr, &jacobian);
    Eigen::Matrix3d h = Eigen::Matrix3d::Zero();
    for (int row = 0; row < jacobian.num_rows; ++row) {
        const Eigen::Vector3d j(&jacobian.values[static_cast<std::size_t>(row) * kParameters]);
        h += j * j.transpose();
    }
    const double scatter = 2 * cost / result.dof;
    const Eigen::FullPivLU<Eigen::Matrix3d> inverse(h);
    if (!inverse.isInvertible()) return result;
    const Eigen::Matrix3d covariance = scatter * inverse.inverse();
    const std::array<double, kParameters> value{p[0], std::exp(p[1]), std::exp(p[2])};
    const std::array<double, kParameters> slope{1, value[1], value[2]};  // of the value by its parameter
    const std::array<const char*, kParameters> name{"center", "width", "exponent"};
    const double t = boost::math::quantile(boost::math::students_t(result.dof), 0.5 + level / 2);
    for (std::size_t i = 0; i < kParameters; ++i) {
        const auto at = static_cast<Eigen::Index>(i);
        const double error = slope[i] * std::sqrt(std::max(0.0, covariance(at, at)));
        result.parameters.push_back({name[i], value[i], error, value[i] - t * error, value[i] + t * error});
        for (std::size_t k = 0; k < kParameters; ++k)
            result.covariance.push_back(slope[i] * slope[k] * covariance(at, static_cast<Eigen::Index>(k)));
    }
    result.chi2 = result.dof;  // by definition: the scatter gives the errors
    result.converged = true;
    return result;
}

}  // namespace pellucid
