// Renders one scene file by one method:
//   render SCENE.toml --method M -o OUT.exr [--stats S.json] [--crop x0,y0,x1,y1] [--max-error E] [--plan]
//          [--shard i/n]
#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <utility>

#include <fmt/ranges.h>
#include <nlohmann/json.hpp>

#include "core/error.hpp"
#include "core/stopwatch.hpp"
#include "field/catalogue.hpp"
#include "field/root_isolation.hpp"
#include "harness/options.hpp"
#include "harness/progress.hpp"
#include "harness/provenance.hpp"
#include "io/atomic_file.hpp"
#include "io/image_file.hpp"
#include "render/method.hpp"
#include "render/shard.hpp"
#include "scene/scene_file.hpp"

namespace {

using namespace pellucid;
using nlohmann::ordered_json;

struct RenderOptions : RunOptions {
    std::string scene, method, output;
    std::optional<std::string> stats, crop, shard;
    std::optional<double> max_error;
    bool plan = false, validate = false, list = false, list_implicit = false;
};

void list_methods() {
    for (const Method& method : methods()) {
        std::string line = fmt::format("{}: {}", method.name, method.summary);
        for (const SettingInfo& s : method.settings)
            line += fmt::format("; {} = {} ({})", s.key, s.default_text, s.meaning);
        std::puts(line.c_str());
    }
}

/// Broken at blanks into lines that fit beside the names.
std::vector<std::string> wrapped(std::string_view text) {
    constexpr std::size_t kWidth = 84;
    std::vector<std::string> lines;
    while (text.size() > kWidth) {
        const std::size_t end = std::min(text.rfind(' ', kWidth), text.size());
        lines.emplace_back(text.substr(0, end));
        text.remove_prefix(std::min(end + 1, text.size()));
    }
    lines.emplace_back(text);
    return lines;
}

void list_catalogue() {
    std::puts("Object space, axis z, negative inside. Below each: parameters = defaults; bounds without a key.");
    for (const CatalogueEntry& e : catalogue()) {
        std::string below;
        for (const auto& p : e.parameters) {
            below += fmt::format("{} = {:.6g}", p.name, p.value);
            if (const std::string range = range_of(p); range != "> 0") below += fmt::format(" ({})", range);
            below += &p == &e.parameters.back() ? "; " : ", ";
        }
        std::vector<std::string> lines = wrapped(fmt::format("{} = 0", e.equation));
        lines.push_back(fmt::format("{}bounds {}", below, e.bounds));
        for (std::size_t i = 0; i < lines.size(); ++i)
            fmt::print("{:<24}{}{}\n", i == 0 ? e.name : "", i > 0 && i + 1 < lines.size() ? "    " : "", lines[i]);
    }
}

/// x0,y0,x1,y1 within the image.
PixelRect parse_crop(const std::string& text, const ImageSettings& image) {
    PixelRect r;
    char rest = 0;
    const int read = std::sscanf(text.c_str(), "%d,%d,%d,%d%c", &r.x0, &r.y0, &r.x1, &r.y1, &rest);
    if (read != 4 || r.x0 < 0 || r.y0 < 0 || r.x1 <= r.x0 || r.y1 <= r.y0 || r.x1 > image.width ||
        r.y1 > image.height)
        throw input_error("--crop {}: expected x0,y0,x1,y1 with 0 <= x0 < x1 <= {} and 0 <= y0 < y1 <= {}",
                          text, image.width, image.height);
    return r;
}

std::string device_of(const Backend& backend) {
    return backend.on_device() ? backend.device_name() : host_info().cpu;
}

ordered_json stats_json(const RenderOptions& options, const RenderStats& stats, const RenderInput& input,
                        double total_s) {
    ordered_json stages = ordered_json::array();
    for (const Stage& s : stats.stages) {
        const ordered_json device_s = s.device_s ? ordered_json(*s.device_s) : ordered_json(nullptr);
        stages.push_back(
            {{"name", s.name}, {"wall_s", s.wall_s}, {"device_s", device_s}, {"bytes", s.bytes}});
    }
    const Backend& backend = input.backend;
    ordered_json json{{"method", options.method}, {"backend", backend.name()}, {"device", device_of(backend)},
                      {"seed", input.seed.value}, {"stages", stages},          {"total_s", total_s},
                      {"peak_rss_bytes", peak_rss_bytes()}};
    json["device_bytes"] = backend.on_device() ? ordered_json(backend.device_bytes()) : ordered_json(nullptr);
    if (stats.repeats > 0) {
        json["particles"] = stats.particles;
        json["repeats"] = stats.repeats;
    } else {
        json["rays"] = stats.rays;
        json["hits"] = stats.hits;
        json["unresolved_pixels"] = stats.unresolved_pixels;
        json["worst_standard_error"] = stats.worst_error;
    }
    json["undecided"] = stats.isolation.undecided;
    json["touching"] = stats.isolation.touching;
    json["poles"] = stats.isolation.poles;
    json["exact_lines"] = stats.isolation.exact;
    json["commit"] = build_info().commit;
    return json;
}

/// What formulas made of the lines that is not a plain root.
void warn_of(const IsolationStats& isolation) {
    if (isolation.touching > 0)
        warn("{} crossings touch zero without a change of sign: they are drawn", isolation.touching);
    if (isolation.undecided > 0)
        warn("{} pieces of lines stay undecided: roots closer than {} of a line's way may be told as one there",
             isolation.undecided, kLeastShare);
    if (isolation.poles > 0) warn("{} changes of sign are poles or gaps: nothing is drawn there", isolation.poles);
}

void print_plan(const std::vector<Stage>& stages) {
    std::int64_t sum = 0;
    for (const Stage& s : stages) {
        fmt::print("{:<20} {:>14} bytes  {}\n", s.name, s.bytes, s.note);
        sum += s.bytes;
    }
    fmt::print("{:<20} {:>14} bytes\n", "total", sum);
}

/// Overrides that name a method's table go to the method, all others to the scene.
Config method_config(const RenderOptions& options, std::vector<std::string>& scene_overrides) {
    Config config = Config::parse("", "--set");
    for (const std::string& assignment : options.overrides) {
        if (is_scene_override(assignment)) {
            scene_overrides.push_back(assignment);
        } else {
            config.apply_override(assignment);
        }
    }
    return config;
}

/// The part that --shard asks for.
ShardPart parse_shard(const RenderOptions& options, const Method& method) {
    const auto part = parse_shard_part(*options.shard);
    if (!part) throw input_error("--shard {}: expected i/n with 0 <= i < n", one_line(*options.shard, 60));
    if (!method.in_shards)
        throw input_error("--shard {}: method {} draws no shards, particles does", *options.shard,
                          method.name);
    if (options.max_error)
        throw input_error("--shard {} with --max-error {}: no shard knows the error of all", *options.shard,
                          *options.max_error);
    if (!options.plan && std::filesystem::path(options.output).extension() != ".exr")
        throw input_error("-o {}: expected a name that ends in .exr for a shard", options.output);
    return *part;
}

int run(RenderOptions options) {
    Stopwatch watch;
    const Method& method = method_by_name(options.method);
    std::vector<std::string> scene_overrides;
    const Config settings = method_config(options, scene_overrides);
    const Scene scene = load_scene(options.scene, scene_overrides);
    require_drawable(method, scene);
    if (options.backend == BackendChoice::all)
        throw input_error("--backend all: a picture is drawn on one, expected cpu or vulkan");
    const Backend backend = open_backends(options, options.validate).front();
    if (backend.on_device() && !method.on_vulkan)
        throw input_error("--backend vulkan: method {} runs on the CPU only", method.name);
    const std::filesystem::path output(options.output);
    if (!options.plan && output.extension() != ".exr" && output.extension() != ".png")
        throw input_error("-o {}: expected a name that ends in .exr or .png", options.output);
    if (options.stats && *options.stats == options.output)
        throw input_error("--stats {}: the image goes there", *options.stats);
    const auto crop = options.crop ? std::optional(parse_crop(*options.crop, scene.image)) : std::nullopt;
    if (options.max_error && !(*options.max_error > 0))
        throw input_error("--max-error {}: expected > 0", *options.max_error);

    Shard shard;
    if (options.shard) shard.part = parse_shard(options, method);

    const PreparedScene prepared = prepare(scene, crop);
    constexpr std::size_t kBarSteps = 1000;
    Progress bar("draw", kBarSteps, !options.plan && !options.quiet && on_terminal());
    std::size_t shown = 0;
    const RenderInput input{.scene = prepared,
                            .settings = settings.root().table(method.name),
                            .seed = {options.seed.value_or(0)},
                            .max_error = options.max_error,
                            .progress = [&](double share) {
                                const auto reached = static_cast<std::size_t>(share * kBarSteps);
                                if (reached > shown) bar.step(reached - std::exchange(shown, reached));
                            },
                            .backend = backend,
                            .shard = options.shard ? &shard : nullptr,
                            .tessellate = settings.root().table("tessellate")};
    method.check_settings(input);
    settings.finish();
    if (options.plan) {
        print_plan(method.plan(input));
        return 0;
    }

    RenderStats stats;
    stats.stages.push_back({"read scene", watch.lap(), static_cast<std::int64_t>(prepared.bytes()), ""});
    const std::uint64_t input_digest =
        options.shard ? digest_of_input(scene, options.scene, prepared.camera.crop()) : 0;
    double total_s = stats.stages.back().wall_s;
    Image image = method.render(input, stats);
    backend.check_validation();
    total_s += watch.lap();
    warn_of(stats.isolation);
    image.attributes["scene"] = options.scene;
    image.attributes["method"] = options.method;
    image.attributes["settings"] = settings.to_json();
    image.attributes["overrides"] = fmt::format("{}", fmt::join(options.overrides, " "));
    image.attributes["seed"] = std::to_string(input.seed.value);
    image.attributes["commit"] = build_info().commit;
    image.attributes["device"] = device_of(backend);
    if (options.shard) {
        write_shard(std::move(image), shard, input_digest, output);
    } else if (output.extension() == ".png") {
        write_png(image, scene.image.background, output);
    } else {
        write_exr(image, output);
    }
    if (options.stats)
        write_text_file(*options.stats, stats_json(options, stats, input, total_s).dump(2) + "\n");
    return 0;
}

}  // namespace

int main(int argc, char** argv) {
    return guarded_main("render", [&] {
        RenderOptions options;
        Arguments arguments("render", "Renders one scene by one method.");
        arguments.positional("SCENE", options.scene, "scene file (TOML)", false);
        arguments.option("--method", options.method, "how to draw: see --list");
        arguments.option("-o,--output", options.output, "OUT.exr (float32, linear) or OUT.png (8 bit, sRGB)");
        arguments.option("--stats", options.stats, "write times, bytes and counts to this JSON file");
        arguments.option("--crop", options.crop, "x0,y0,x1,y1: draw these pixels of the image only");
        arguments.option("--max-error", options.max_error,
                         "stop when every pixel's standard error is at most this; particles: as estimated, which makes the mean\n"
                         "of pixels that are alone in their tile too low, by up to a third of it");
        arguments.option("--shard", options.shard,
                         "i/n, i = 0 ... n-1: draw this part of the repeats, for merge");
        arguments.flag("--plan", options.plan, "list stages and bytes, draw nothing");
        arguments.flag("--validate", options.validate, "Vulkan: with validation layers (the CPU has none)");
        arguments.flag("--list", options.list, "list methods with settings and what they draw");
        arguments.flag("--list-implicit", options.list_implicit, "list the implicit surfaces by name");
        add_run_options(arguments, options);
        if (!arguments.parse(argc, argv)) return 0;
        if (options.list) list_methods();
        if (options.list_implicit) list_catalogue();
        if (options.list || options.list_implicit) return 0;
        if (options.scene.empty()) throw input_error("no scene file: see render --help");
        if (options.method.empty()) throw input_error("no --method: see render --list");
        if (options.output.empty() && !options.plan) throw input_error("no output file: -o OUT.exr");
        apply_run_options(options);
        return run(std::move(options));
    });
}
