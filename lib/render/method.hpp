// Methods by name: what each can draw, which settings it takes, and how to run it.
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "core/image.hpp"
#include "core/random.hpp"
#include "field/isolation_stats.hpp"
#include "io/config.hpp"
#include "render/backend.hpp"
#include "scene/prepared_scene.hpp"

namespace pellucid {

struct Shard;  // render/shard.hpp

/// One line of S.json's "stages", of --plan and of an experiment's table of times.
struct Stage {
    std::string name;
    double wall_s = 0;
    std::int64_t bytes = 0;  // held at most
    std::string note;        // what it works on: "3 objects, 51 214 pieces"
    std::optional<double> device_s = {};  // by the device's own clock
};

struct RenderStats {
    std::vector<Stage> stages;
    std::uint64_t particles = 0;
    std::uint64_t repeats = 0;
    std::uint64_t rays = 0;
    std::uint64_t hits = 0;
    std::uint64_t layers = 0;             // most surfaces that one pixel took
    std::uint64_t unresolved_pixels = 0;  // truth: pixels with a larger standard error than asked
    IsolationStats isolation;             // what formulas could not decide
    double worst_error = 0;               // truth: the largest standard error that is left
};

struct RenderInput {
    const PreparedScene& scene;
    ConfigTable settings;             // this method's own table
    Seed seed;
    std::optional<double> max_error;  // --max-error
    std::function<void(double share)> progress = [](double) {};
    Backend backend = Backend::cpu();
    /// Draw this part (shard->part) of the repeats only, and leave its sums here; null: all of them.
    Shard* shard = nullptr;
    /// Table [tessellate], shared by all methods that rasterise; absent: its defaults.
    std::optional<ConfigTable> tessellate = {};
};

/// A setting as `render --list` shows it.
struct SettingInfo {
    std::string_view key;      // "particles.repeats"
    std::string_view default_text;
    std::string_view meaning;
};

struct Method {
    std::string_view name;
    std::string_view summary;  // one line: what it draws
    std::vector<SettingInfo> settings;
    /// Why the method cannot draw the scene, naming the object; empty where it can.
    std::function<std::optional<std::string>(const Scene&)> refusal;
    /// Reads and checks the settings, and nothing else.
    std::function<void(const RenderInput&)> check_settings;
    /// The stages the scene requires and the bytes they will hold, before anything of that is allocated.
    std::function<std::vector<Stage>(const RenderInput&)> plan;
    std::function<Image(const RenderInput&, RenderStats&)> render;
    bool on_vulkan = false;  // has stages for RenderInput::backend other than the CPU
    bool in_shards = false;  // takes RenderInput::shard
};

[[nodiscard]] const std::vector<Method>& methods();
/// Throws Error(input) that lists the known names.
[[nodiscard]] const Method& method_by_name(std::string_view name);
/// Throws Error(input) where the method refuses the scene.
void require_drawable(const Method& method, const Scene& scene);

}  // namespace pellucid
