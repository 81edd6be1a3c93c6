#include "study/method_image.hpp"

namespace pellucid {

Image method_image(const PreparedScene& scene, const MethodChoice& choice, Seed seed, RenderStats& stats,
                   const Backend& backend) {
    const Method& method = method_by_name(choice.method);
    require_drawable(method, scene.settings);
    Config config = Config::parse("", choice.method);
    for (const std::string& setting : choice.settings) config.apply_override(setting);
    const RenderInput input{.scene = scene,
                            .settings = config.root().table(method.name),
                            .seed = seed,
                            .max_error = {},
                            .backend = backend,
                            .tessellate = config.root().table("tessellate")};
    method.check_settings(input);
    config.finish();
    return method.render(input, stats);
}

}  // namespace pellucid
