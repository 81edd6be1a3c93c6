#include "study/parity_report.hpp"

#include "measure/statistics.hpp"

namespace pellucid {
namespace {

std::string title(const ParityStage& stage, const Implementation& each) {
    return fmt::format("{}, {}, {} threads", stage.name, each.name, each.threads);
}

}  // namespace

ParityReport::ParityReport(Experiment& experiment)
    : experiment_(&experiment),
      table_(&experiment.csv("parity", {"scene",
                                        "projection",
                                        "stage",
                                        "implementation",
                                        "device",
                                        "threads",
                                        "repeats",
                                        "particles",
                                        "hits",
                                        "winners_equal_share",
                                        "largest_mean_difference_units",
                                        "largest_sum_difference_units",
                                        "different",
                                        "hash",
                                        "hash_is_specified",
                                        "time_s",
                                        "fastest_s",
                                        "slowest_s",
                                        "device_s",
                                        "particles_per_s"})),
      device_(&experiment.csv("device", {"scene", "stage", "implementation", "device", "part", "device_s"})) {
}

void ParityReport::add(const ParityScene& scene, const ParityStage& stage, const Implementation& each,
                       const ParityRow& row, std::uint64_t specified) {
    const std::optional<double> time_s = median(row.wall_s);
    const auto particles = static_cast<double>(scene.particles.count());
    std::optional<double> device_s;
    for (const StageTime& part : row.device_s) {
        device_s = device_s.value_or(0) + part.device_s;
        device_->row(scene.name, stage.name, each.name, each.device, part.name, part.device_s);
    }
    const ParityDifference& d = row.difference;
    const char* projection = scene.scene->camera.perspective() ? "perspective" : "orthographic";
    table_->row(scene.name, projection, stage.name, each.name, each.device, each.threads,
                scene.particles.repeats.size(), scene.particles.count(), d.hits, d.winners_equal_share,
                d.largest_mean_units, d.largest_sum_units, d.different, fmt::format("{:016x}", row.hash),
                row.hash == specified, time_s, quantile(row.wall_s, 0), quantile(row.wall_s, 1), device_s,
                time_s ? std::optional(particles / *time_s) : std::nullopt);
    worst_[title(stage, each)].merge(d);
}

void ParityReport::check_equal(const ParityStage& stage, const Implementation& each) {
    const std::string name = title(stage, each);
    const ParityDifference& d = worst_[name];
    if (d.winners_equal_share)
        experiment_->check(name + ": least share of equal winners", *d.winners_equal_share, "==", 1);
    if (d.largest_mean_units)
        experiment_->check(name + ": largest difference of a mean, in 1/65535", *d.largest_mean_units,
                           "<=", 1);
    experiment_->check(name + ": different, of anything", static_cast<double>(d.different), "==", 0);
}

void ParityReport::check_seen(const ParityStage& stage, const Implementation& each) {
    const ParityDifference& d = worst_[title(stage, each)];
    experiment_->check(each.name + " is seen: least share of equal winners",
                       d.winners_equal_share.value_or(1), "<", 1);
}

}  // namespace pellucid
