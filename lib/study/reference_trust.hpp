// What `reference_trust` asks: a table and its checks a topic. What is measured stands in trust_*.hpp.
//
// Limits follow from theory: Embree's stated tolerance, the number of roundings, the law of a count. None was
// tuned.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "harness/experiment.hpp"

namespace pellucid {

/// Of all tests of one topic together.
inline constexpr double kTrustLevel = 0.001;

struct ParitySettings {
    std::filesystem::path mesh_folder;  // of `files`; those that are not there are left out with a word
    std::vector<std::string> files;
    std::vector<double> scales, offsets;
    std::uint64_t random_rays, aimed_rays, checked_rays;  // a mesh, place and aim
};
[[nodiscard]] ParitySettings read_parity_settings(const ConfigTable& config);
/// parity.csv: a row a mesh, place and aim.
void report_parity(Experiment& ex, const ParitySettings& settings);

struct ClosedFormSettings {
    std::vector<double> scales, offsets, distances;
    std::uint64_t rays;  // a row
    std::vector<double> grazing_deltas, grazing_offsets;
    std::uint64_t grazing_rays;
};
[[nodiscard]] ClosedFormSettings read_closed_form_settings(const ConfigTable& config);
/// closed_form.csv: a row a shape, projection, scale, offset and distance. grazing.csv: a row an offset, side
/// and δ.
void report_closed_form(Experiment& ex, const ClosedFormSettings& settings);
void report_grazing(Experiment& ex, const ClosedFormSettings& settings);

struct RootSettings {
    std::uint64_t lines, checked;  // a surface and kind of line
};
[[nodiscard]] RootSettings read_root_settings(const ConfigTable& config);
/// roots.csv: a row a surface, kind of line and way of finding.
void report_roots(Experiment& ex, const RootSettings& settings);

struct ImageSettingsOfTrust {
    int pixels;  // a side of the small pictures
    std::size_t seeds;
    std::vector<double> max_errors;
    int max_samples;
    int particle_pixels;
    std::uint32_t repeats;
    double truth_error;
    int truth_samples;
    double twin_error;  // of optical depth
    int coincident_pixels;
};
[[nodiscard]] ImageSettingsOfTrust read_image_settings(const ConfigTable& config);
/// stated_error.csv: a row a scene, filter and max_error; without one every pixel got 64 sub-rays, and the
/// stated variance is unbiased. Where an error is asked for, pixels whose estimate says more than twice that
/// are traced anew: of those that are kept too few say much, so the ratio may fall below 1. It is measured,
/// not judged; judged is whether the error stays below the larger of stated and asked. Scenes without finite
/// variance are measured only.
void report_stated_error(Experiment& ex, const ImageSettingsOfTrust& settings);
/// particle_filter.csv: a row a scene and twin.
void report_particle_filter(Experiment& ex, const ImageSettingsOfTrust& settings);
/// coincident.csv: a row a kind and number of layers.
void report_coincident(Experiment& ex, const ImageSettingsOfTrust& settings);

struct RestartSettings {
    std::vector<double> epsilons;  // in radii of the mesh
    std::vector<double> gaps;      // between thin plates, in half-sides
    std::uint64_t rays;
};
[[nodiscard]] RestartSettings read_restart_settings(const ConfigTable& config);
/// restart.csv: a row a mesh, aim and epsilon; the truth's own rows have none.
void report_restart(Experiment& ex, const RestartSettings& settings);

}  // namespace pellucid
