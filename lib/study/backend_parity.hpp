// What `backend_parity` compares: implementations of the same stages, each with the plain CPU version, which
// is the specification. A stage is an entry of parity_stages(): how it is run, and how two of its outputs
// differ.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "render/backend.hpp"
#include "sample/particle_sampler.hpp"
#include "study/faulty_drawer.hpp"

namespace pellucid {

/// What every implementation is given.
struct ParityScene {
    std::string name;
    std::unique_ptr<const PreparedScene> scene;  // drawers refer to it
    ParticleSet particles;
};

/// A scene file at a height of so many pixels, its own shape kept, and particles for so many repeats.
/// `why_not` says why there is none: a volume that is not installed, or a shape the method does not draw.
[[nodiscard]] std::optional<ParityScene> sample_parity_scene(const std::filesystem::path& file, int height_px,
                                                             std::uint32_t repeats, Seed seed,
                                                             std::string& why_not);

/// Not of a surface: particles on and beside the borders of pixels, tiles and image, every second one at one
/// and the same depth. Here all that may tell backends apart happens often. `like` gives camera and
/// materials.
[[nodiscard]] ParityScene make_border_scene(const ParityScene& like, std::uint32_t particles_a_repeat,
                                            std::uint32_t repeats, Seed seed);

/// One way to run the stages. `with` runs its argument under the implementation's own threads and instruction
/// set.
struct Implementation {
    std::string name;
    std::string device;
    int threads = 1;
    std::int64_t target = 0;  // of Highway; 0: the best there is
    std::function<std::unique_ptr<ParticleDrawer>(const PreparedScene&)> make_drawer;
    void with(const std::function<void()>& run) const;
};

/// The specification first; then the plain version with all threads; for the CPU the fast version with one
/// thread, and with all threads on every instruction set there is; every Vulkan device.
[[nodiscard]] std::vector<Implementation> parity_implementations(const std::vector<Backend>& backends);
[[nodiscard]] Implementation faulty_implementation(const std::string& name, DrawFault fault);

/// What a stage gave; each stage fills its own.
struct StageOutput {
    std::vector<Winners> winners;
    std::optional<EnsembleSums> sums;
};

/// How far an output is from the specification's. Empty: not a matter of this stage.
struct ParityDifference {
    std::uint64_t hits = 0;  // pixels hit by the specification, over all repeats
    std::optional<double> winners_equal_share = {};  // of all particles that win on either side
    /// Of a pixel's mean colour, in color units: 1/65535 but in bright scenes (color_units_of).
    std::optional<double> largest_mean_units = {};
    std::optional<double> largest_sum_units = {};
    std::uint64_t different = 0;  // particles that win on one side only or elsewhere; pixels
    /// The larger of each.
    void merge(const ParityDifference& other);
};

struct ParityStage {
    std::string name;
    std::function<StageOutput(ParticleDrawer&, const ParityScene&)> run;
    std::function<ParityDifference(const StageOutput& specified, const StageOutput& other)> compare;
    std::function<std::uint64_t(const StageOutput&)> hash;  // FNV-1a of the output
};

/// "winners", "colours".
[[nodiscard]] const std::vector<ParityStage>& parity_stages();

/// One implementation's runs of one stage.
struct ParityRow {
    ParityDifference difference;      // the worst of all runs
    std::uint64_t hash = 0;           // of the first run
    std::vector<double> wall_s;       // run by run, without the first
    std::vector<StageTime> device_s;  // a run, by part; empty for the CPU
};

/// Runs a stage by all implementations, the first of which is the specification: once each to warm up, then
/// `runs` times, interleaved in random order. Every run's output is compared.
[[nodiscard]] std::vector<ParityRow> run_parity(const ParityStage& stage, const ParityScene& scene,
                                                const std::vector<Implementation>& implementations, int runs,
                                                Seed seed);

}  // namespace pellucid
