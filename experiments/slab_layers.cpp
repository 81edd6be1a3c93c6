// How many layers does a z-thickness buffer need, and at what price? zSlab dissertation, figures 6.7, 6.8, 6.18.
// configs/slab_layers.toml, scenes/slabs/layers_* -> results/slab_layers/ -> analysis/slab_layers.py
#include <algorithm>
#include <cmath>
#include <numeric>
#include <random>

#include "core/error.hpp"
#include "core/stopwatch.hpp"
#include "harness/experiment.hpp"
#include "measure/flip.hpp"
#include "measure/image_metrics.hpp"
#include "reference/truth.hpp"
#include "scene/scene_file.hpp"
#include "study/method_image.hpp"

using namespace pellucid;

namespace {

struct Settings {
    std::vector<std::string> backends, scenes, intermix;
    std::filesystem::path folder;
    std::vector<std::int64_t> error_resolution;
    std::string mixing;
    int truth_samples;
    double error_limit;
    /// What a device in software has no hours for.
    struct OfBackend {
        std::vector<std::int64_t> layers, resolutions;
        int runs;
    };
    OfBackend cpu, cpu_large, device;
    [[nodiscard]] const OfBackend& of(const Backend& backend) const { return backend.on_device() ? device : cpu; }
    [[nodiscard]] std::vector<OfBackend> timed(const Backend& backend) const {
        if (backend.on_device()) return {device};
        return {cpu, cpu_large};
    }
};

Settings::OfBackend read_backend(const ConfigTable& t) {
    Settings::OfBackend s;
    s.layers = t.integers("layers", kRequired, {2, 1024}, {.min = 2});
    s.resolutions = t.integers("resolutions", kRequired, {1, 1 << 14});
    s.runs = static_cast<int>(t.integer("runs", kRequired, {1, 1 << 10}));
    if (!std::ranges::is_sorted(s.layers)) throw input_error("layers are not in ascending order");
    return s;
}

Settings read_settings(const ConfigTable& t) {
    Settings s;
    s.backends = t.texts("backends", kRequired);
    s.folder = t.file("folder");
    s.scenes = t.texts("scenes", kRequired);
    s.cpu = read_backend(t.table("cpu"));
    s.cpu_large = read_backend(t.table("cpu_large"));
    s.device = read_backend(t.table("vulkan"));
    s.intermix = t.texts("intermix", kRequired);
    s.mixing = t.text("mixing", kRequired);
    s.error_resolution = t.integers("error_resolution", kRequired, {11, 1 << 14}, exactly(2));
    s.truth_samples = static_cast<int>(t.integer("truth_samples", kRequired, {1, 1 << 20}));
    s.error_limit = t.number("error_limit", kRequired, above(0));
    return s;
}

/// "scientific" of layers_scientific.toml; empty where a volume's file is not there.
std::optional<Scene> read_scene(const Settings& s, const std::string& name) {
    Config config = Config::read(s.folder / (name + ".toml"));
    Scene scene = scene_from_config(config);
    config.finish();
    for (const Volume& volume : scene.volumes) {
        const auto* file = std::get_if<std::filesystem::path>(&volume.source);
        if (file == nullptr || std::filesystem::exists(*file)) continue;
        warn("{}: left out, {} is not there", name, file->string());
        return std::nullopt;
    }
    if (scene.volumes.size() < 2) throw input_error("{}: {} volumes, expected two or more", name, scene.volumes.size());
    return scene;
}

Scene resized(Scene scene, std::int64_t width, std::int64_t height) {
    scene.image.width = static_cast<int>(width);
    scene.image.height = static_cast<int>(height);
    return scene;
}

MethodChoice slabs(const Settings& s, const std::string& intermix, std::int64_t layers, bool skip) {
    return {"slabs",
            {fmt::format("slabs.layers={}", layers), fmt::format("slabs.intermix=\"{}\"", intermix),
             fmt::format("slabs.mixing=\"{}\"", s.mixing), fmt::format("slabs.skip={}", skip)}};
}
MethodChoice mdvr(const Settings& s, bool skip, int rays = 1) {
    return {"mdvr",
            {fmt::format("mdvr.mixing=\"{}\"", s.mixing), fmt::format("mdvr.skip={}", skip), fmt::format("mdvr.rays={}", rays)}};
}

// ---- Error over layers --------------------------------------------------------------------------------------

/// The least number of layers whose error is within a tenth of `floor`; empty where none is.
std::optional<std::int64_t> layers_enough(const std::vector<std::int64_t>& layers, const std::vector<double>& error, double floor) {
    for (std::size_t i = 0; i < layers.size(); ++i)
        if (error[i] <= 1.1 * floor) return layers[i];
    return std::nullopt;
}

RgbImage draw_truth(Experiment& ex, const Settings& s, const std::string& name, const PreparedScene& scene) {
    const auto stage = ex.stage("truth");
    TruthStats stats;
    const TruthSettings settings{.filter = PixelFilter::box, .seed = derived_seed(ex.seed(), 1), .samples = s.truth_samples};
    const Image image = trace_truth(scene, settings, stats);
    ex.png("pictures/" + name + "_truth", image, scene.settings.image.background);
    return over_background(image, scene.settings.image.background, "truth");
}

void measure_errors(Experiment& ex, const Settings& s, const std::string& name, const PreparedScene& prepared, const RgbImage& truth,
                    const Backend& backend, CsvWriter& csv, CsvWriter& enough) {
    const Vec3& background = prepared.settings.image.background;
    const std::vector<std::int64_t>& all_layers = s.of(backend).layers;
    const auto draw = [&](const MethodChoice& choice) {
        RenderStats stats;
        return method_image(prepared, choice, ex.seed(), stats, backend);
    };
    const Image cast = draw(mdvr(s, true));
    const RgbImage conventional = over_background(cast, background, "mdvr");
    const std::optional<double> none;
    const double floor = rmse(conventional, truth);
    csv.row(name, backend.name(), "mdvr", none, none, floor, none, flip(conventional, truth).mean);
    if (!backend.on_device()) ex.png("pictures/" + name + "_mdvr", cast, background);
    for (const std::string& intermix : s.intermix) {
        std::vector<double> beside_mdvr, beside_truth;
        for (const std::int64_t layers : all_layers) {
            const Image image = draw(slabs(s, intermix, layers, true));
            const RgbImage test = over_background(image, background, "slabs");
            beside_mdvr.push_back(rmse(test, conventional));
            beside_truth.push_back(rmse(test, truth));
            csv.row(name, backend.name(), intermix, layers, beside_mdvr.back(), beside_truth.back(), flip(test, conventional).mean,
                    flip(test, truth).mean);
            if (!backend.on_device() && (layers == all_layers.front() || layers == 4 || layers == 8))
                ex.png(fmt::format("pictures/{}_{}_{}", name, intermix, layers), image, background);
        }
        const std::string which = fmt::format("{}, {}, {}", name, backend.name(), intermix);
        enough.row(name, backend.name(), intermix, layers_enough(all_layers, beside_truth, floor),
                   layers_enough(all_layers, beside_mdvr, beside_mdvr.back()));
        ex.check(which + ": error of the most layers over that of the fewest", beside_mdvr.back() / beside_mdvr.front(), "<", 1);
        for (std::size_t i = 0; i < all_layers.size(); ++i)
            if (all_layers[i] == 8) ex.check(which + ": RMSE of 8 layers beside mdvr", beside_mdvr[i], "<=", s.error_limit);
    }
}

// ---- Time over layers ---------------------------------------------------------------------------------------

struct Timed {
    std::string method, intermix;  // intermix: of slabs
    std::optional<std::int64_t> layers;
    bool skip;
    MethodChoice choice;
    std::vector<double> seconds;
    std::vector<Stage> stages;  // of the last run
};

std::vector<Timed> what_is_timed(const Settings& s, const std::vector<std::int64_t>& all_layers) {
    std::vector<Timed> all;
    for (const bool skip : {true, false}) all.push_back({"mdvr", "", {}, skip, mdvr(s, skip), {}, {}});
    for (const std::string& intermix : s.intermix)
        for (const std::int64_t layers : all_layers)
            all.push_back({"slabs", intermix, layers, true, slabs(s, intermix, layers, true), {}, {}});
    for (const std::string& intermix : s.intermix)
        all.push_back({"slabs", intermix, 8, false, slabs(s, intermix, 8, false), {}, {}});
    return all;
}

double median(std::vector<double> values) {
    std::ranges::sort(values);
    const std::size_t half = values.size() / 2;
    return values.size() % 2 == 1 ? values[half] : 0.5 * (values[half - 1] + values[half]);
}

void measure_times(Experiment& ex, const Settings& s, const std::string& name, const Scene& whole, const Settings::OfBackend& how,
                   std::int64_t side, const Backend& backend, CsvWriter& csv, CsvWriter& stages) {
    const PreparedScene prepared = prepare(resized(whole, side, side));
    std::vector<Timed> all = what_is_timed(s, how.layers);
    const int runs = how.runs;
    std::vector<std::size_t> order(all.size());
    std::iota(order.begin(), order.end(), std::size_t{0});
    std::mt19937_64 random(derived_seed(ex.seed(), 2).value);
    for (int run = -1; run < runs; ++run) {
        std::ranges::shuffle(order, random);
        for (const std::size_t i : order) {
            RenderStats stats;
            Stopwatch watch;
            (void)method_image(prepared, all[i].choice, ex.seed(), stats, backend);
            const double seconds = watch.lap();
            if (run < 0) continue;
            all[i].seconds.push_back(seconds);
            all[i].stages = stats.stages;
        }
    }
    for (const Timed& t : all) {
        const auto [least, most] = std::ranges::minmax(t.seconds);
        csv.row(name, backend.name(), side, t.method, t.intermix, t.layers, t.skip, runs, median(t.seconds), least, most);
        for (const Stage& stage : t.stages)
            stages.row(name, backend.name(), side, t.method, t.intermix, t.layers, t.skip, stage.name, stage.bytes, stage.wall_s,
                       stage.device_s);
    }
}

void run(Experiment& ex) {
    const Settings s = ex.config(read_settings);
    const std::vector<Backend>& backends = ex.backends(s.backends);
    CsvWriter& errors = ex.csv("errors", {"scene", "backend", "method", "layers", "rmse_mdvr", "rmse_truth", "flip_mdvr", "flip_truth"});
    CsvWriter& enough = ex.csv("enough", {"scene", "backend", "intermix", "truth_layers", "mdvr_layers"});
    CsvWriter& times = ex.csv("times", {"scene", "backend", "side_px", "method", "intermix", "layers", "skip", "runs", "median_s", "least_s",
                                        "most_s"});
    CsvWriter& stages = ex.csv("stages", {"scene", "backend", "side_px", "method", "intermix", "layers", "skip", "stage", "stage_bytes",
                                          "wall_s", "device_s"});
    auto progress = ex.progress("scenes", s.scenes.size() * backends.size());
    std::size_t drawn = 0;
    for (const std::string& name : s.scenes) {
        const auto scene = read_scene(s, name);
        drawn += scene ? 1U : 0U;
        std::optional<PreparedScene> judged;
        std::optional<RgbImage> truth;
        if (scene) {
            judged = prepare(resized(*scene, s.error_resolution[0], s.error_resolution[1]));
            truth = draw_truth(ex, s, name, *judged);
        }
        for (const Backend& backend : backends) {
            if (scene) measure_errors(ex, s, name, *judged, *truth, backend, errors, enough);
            for (const Settings::OfBackend& how : s.timed(backend))
                for (const std::int64_t side : how.resolutions)
                    if (scene) measure_times(ex, s, name, *scene, how, side, backend, times, stages);
            progress->step();
        }
    }
    if (drawn == 0) throw input_error("scenes: none of them has its volumes");
}

}  // namespace

int main(int argc, char** argv) {
    return run_experiment(argc, argv,
                          {.name = "slab_layers", .question = "How many layers does a z-thickness buffer need, and at what price?"},
                          run);
}
