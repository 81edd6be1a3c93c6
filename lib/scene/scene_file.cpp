#include "scene/scene_file.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <set>

#include <fmt/format.h>

namespace pellucid {

namespace {

constexpr std::int64_t kMaxSide = 65536;
constexpr std::int64_t kMaxPixels = std::int64_t{1} << 31;  // pixel indices are 32-bit in every backend
constexpr std::int64_t kMaxVoxels = std::int64_t{1} << 31;  // 8 GiB of float32
// Sines below this count as parallel: with less, fewer than half the digits of a cross product are left.
constexpr double kMinSine = 1e-8;
const Range kUnit = within(0, 1);

bool parallel_or_zero(const Vec3& a, const Vec3& b) {
    const double lengths = length(a) * length(b);
    return !(length(cross(a, b)) > kMinSine * lengths) || !std::isfinite(lengths);
}

bool zero_or_huge(const Vec3& v) {
    return !(length(v) > 0) || !std::isfinite(length(v));
}

// ---- image, camera, lights

ImageSettings read_image(const ConfigTable& root) {
    const ConfigTable table = root.table("image");
    if (!table.present())
        throw root.error("image", "is missing, expected a table [image] with resolution = [width, height]");
    const auto sides = table.integers("resolution", kRequired, {1, kMaxSide}, exactly(2));
    if (sides[0] * sides[1] > kMaxPixels)
        throw table.error("resolution", fmt::format("= [{}, {}], expected at most {} pixels", sides[0],
                                                    sides[1], kMaxPixels));
    return {.width = static_cast<int>(sides[0]),
            .height = static_cast<int>(sides[1]),
            .background = table.vec3("background", Vec3(0.0), kUnit)};
}

CameraSettings read_camera(const ConfigTable& root) {
    const ConfigTable table = root.table("camera");
    if (!table.present()) throw root.error("camera", "is missing, expected a table [camera] with a position");
    CameraSettings camera;
    camera.projection = table.choice<Projection>(
        "projection", Projection::perspective,
        {{"perspective", Projection::perspective}, {"orthographic", Projection::orthographic}});
    camera.position = table.vec3("position", kRequired);
    camera.target = table.vec3("target", camera.target);
    camera.up = table.vec3("up", camera.up);
    camera.fov_degrees = table.number("fov_degrees", camera.fov_degrees, strictly_within(0, 180));
    camera.view_height = table.number("view_height", camera.view_height, above(0));
    camera.near = table.number_if("near", at_least(0));
    camera.far = table.number_if("far", above(0));

    const Vec3 view = camera.target - camera.position;
    if (zero_or_huge(view))
        throw table.error("position", "is the target, expected two places a finite way apart");
    if (zero_or_huge(camera.up)) throw table.error("up", "has no length, expected a direction");
    if (parallel_or_zero(view, camera.up)) throw table.error("up", "is parallel to the view direction");
    if (camera.near && camera.far && !(*camera.near < *camera.far))
        throw table.error("far", fmt::format("= {}, expected > near = {}", *camera.far, *camera.near));
    return camera;
}

std::vector<Light> read_lights(const ConfigTable& root) {
    std::vector<Light> lights;
    for (const ConfigTable& table : root.tables("light")) {
        Light light;
        light.headlight = table.boolean("headlight", false);
        light.intensity = table.number("intensity", 1.0, at_least(0));
        if (light.headlight == table.has("direction"))
            throw table.error("", light.headlight
                                      ? "has headlight = true and a direction, expected one of them"
                                      : "has no direction, expected one, or headlight = true");
        if (!light.headlight) {
            const Vec3 direction = table.vec3("direction", kRequired);
            if (zero_or_huge(direction))
                throw table.error("direction", "has no length, expected a direction");
            light.direction = normalize(direction);
        }
        lights.push_back(light);
    }
    if (lights.empty()) lights.push_back({.headlight = true});
    return lights;
}

// ---- what surfaces and volumes share

Box read_bounds(const ConfigTable& table) {
    const auto corners = table.rows("bounds", 3, exactly(2));
    Box box;
    for (int axis = 0; axis < 3; ++axis) {
        const auto i = static_cast<std::size_t>(axis);
        if (!(corners[0][i] < corners[1][i]))
            throw table.error("bounds", fmt::format("are inside out: {} = {} … {}, expected low < high",
                                                    "xyz"[i], corners[0][i], corners[1][i]));
        box.lo[axis] = corners[0][i];
        box.hi[axis] = corners[1][i];
    }
    return box;
}

std::vector<TransferPoint> read_transfer(const ConfigTable& table) {
    std::vector<TransferPoint> points;
    for (const std::vector<double>& row : table.rows("transfer", 5)) {
        for (std::size_t i = 1; i < 5; ++i)
            if (!kUnit.contains(row[i]))
                throw table.error("transfer",
                                  fmt::format("at value {} has {} = {}, expected [0, 1]", row[0],
                                              std::array{"red", "green", "blue", "opacity"}[i - 1], row[i]));
        if (!points.empty() && row[0] < points.back()[0])
            throw table.error("transfer",
                              fmt::format("values fall from {} to {}, expected them in rising order",
                                          points.back()[0], row[0]));
        points.push_back({row[0], row[1], row[2], row[3], row[4]});
    }
    return points;
}

Shading read_shading(const ConfigTable& table, const Shading& fallback) {
    if (table.kind("shading") == ValueKind::string) {
        table.one_of("shading", kRequired, {"flat"});
        return {.flat = true};
    }
    if (!table.has("shading") && fallback.flat) {
        table.one_of("shading", "flat", {"flat"});
        return fallback;
    }
    const ConfigTable terms = table.table("shading");
    Shading shading;
    shading.ambient = terms.number("ambient", shading.ambient, at_least(0));
    shading.diffuse = terms.number("diffuse", shading.diffuse, at_least(0));
    shading.specular = terms.number("specular", shading.specular, at_least(0));
    shading.shininess = terms.number("shininess", shading.shininess, above(0));
    return shading;
}

Mat3 rotation(int axis, double degrees) {
    const double turn = std::remainder(degrees, 360.0);
    double c = std::cos(turn * std::numbers::pi / 180);
    double s = std::sin(turn * std::numbers::pi / 180);
    // Quarter turns are exact, so an axis-aligned box stays one.
    if (std::remainder(turn, 90.0) == 0.0) {
        c = std::round(c);
        s = std::round(s);
    }
    const int i = (axis + 1) % 3;
    const int j = (axis + 2) % 3;
    Mat3 m(1.0);
    m[i][i] = c;
    m[i][j] = s;  // column i, row j
    m[j][i] = -s;
    m[j][j] = c;
    return m;
}

bool invertible(const Affine& map) {
    Mat3 unit = map.linear;
    for (int column = 0; column < 3; ++column) {
        if (zero_or_huge(unit[column])) return false;
        unit[column] = normalize(unit[column]);
    }
    // Relative to the lengths of the columns: a scene in micrometres is not singular.
    return std::abs(glm::determinant(unit)) > kMinSine;
}

Affine read_placement(const ConfigTable& table) {
    Affine map;
    if (table.has("matrix")) {
        for (const char* key : {"scale", "rotate_degrees", "translate"})
            if (table.has(key)) throw table.error(key, "stands beside matrix, expected one or the other");
        const std::vector<double> m = table.numbers("matrix", kRequired, {}, exactly(16));
        for (std::size_t row = 0; row < 3; ++row) {
            const auto r = static_cast<int>(row);
            for (std::size_t column = 0; column < 3; ++column)
                map.linear[static_cast<int>(column)][r] = m[4 * row + column];
            map.offset[r] = m[4 * row + 3];
        }
        if (m[12] != 0 || m[13] != 0 || m[14] != 0 || m[15] != 1)
            throw table.error("matrix", fmt::format("has the last row {} {} {} {}, expected 0 0 0 1", m[12],
                                                    m[13], m[14], m[15]));
        if (!invertible(map)) throw table.error("matrix", "is singular, expected an invertible one");
        return map;
    }
    // p_world = T·Rz·Ry·Rx·S·p
    const Vec3 scale = table.kind("scale") == ValueKind::array ? table.vec3("scale", kRequired)
                                                               : Vec3(table.number("scale", 1.0));
    const Vec3 degrees = table.vec3("rotate_degrees", Vec3(0.0));
    map.offset = table.vec3("translate", Vec3(0.0));
    Mat3 scaling(1.0);
    for (int axis = 0; axis < 3; ++axis) scaling[axis][axis] = scale[axis];
    map.linear = rotation(2, degrees.z) * rotation(1, degrees.y) * rotation(0, degrees.x) * scaling;
    if (!invertible(map))
        throw table.error("scale", "makes a singular matrix, expected numbers other than 0");
    return map;
}

std::vector<ClipPlane> read_clip(const ConfigTable& table) {
    std::vector<ClipPlane> planes;
    for (const ConfigTable& entry : table.tables("clip")) {
        const ClipPlane plane{.normal = entry.vec3("normal", kRequired),
                              .offset = entry.number("offset", 0.0)};
        if (zero_or_huge(plane.normal)) throw entry.error("normal", "has no length, expected a direction");
        planes.push_back(plane);
    }
    return planes;
}

std::string read_name(const ConfigTable& table, const std::string& fallback) {
    std::string name = table.text("name", fallback);
    if (name.empty()) throw table.error("name", "is empty, expected a name");
    return name;
}

// ---- surfaces

/// center, u, v of a rectangle or slice.
void read_frame(const ConfigTable& table, Vec3& center, Vec3& u, Vec3& v) {
    center = table.vec3("center", Vec3(0.0));
    u = table.vec3("u", u);
    v = table.vec3("v", v);
    if (zero_or_huge(u)) throw table.error("u", "has no length, expected a half-edge");
    if (zero_or_huge(v)) throw table.error("v", "has no length, expected a half-edge");
    if (parallel_or_zero(u, v)) throw table.error("v", "is parallel to u, expected two edges of a rectangle");
}

constexpr std::array kShapeKeys{"implicit", "expression", "isosurface", "mesh",
                                "points",   "rectangle",  "slice"};

Shape read_shape(const ConfigTable& table) {
    std::vector<std::string> found;
    for (const char* key : kShapeKeys)
        if (table.has(key)) found.emplace_back(key);
    if (found.size() != 1)
        throw table.error(
            "", fmt::format("has {}, expected exactly one of {}",
                            found.empty() ? "no shape" : fmt::format("{}", fmt::join(found, " and ")),
                            fmt::join(kShapeKeys, ", ")));
    const std::string& kind = found.front();
    if (kind != "implicit" && table.has("parameters"))
        throw table.error("parameters", fmt::format("belong to implicit, not to {}", kind));

    const auto text = [&](const char* key) {
        std::string value = table.text(key, kRequired);
        if (value.empty()) throw table.error(key, "is empty");
        return value;
    };
    if (kind == "implicit")
        return ImplicitShape{.name = text("implicit"), .parameters = table.number_map("parameters")};
    if (kind == "expression") return ExpressionShape{.text = text("expression")};
    if (kind == "mesh") return MeshShape{.file = table.file("mesh")};
    if (kind == "points") return PointsShape{.file = table.file("points")};
    const ConfigTable shape = table.table(kind);
    if (kind == "isosurface")
        return IsosurfaceShape{
            .volume = shape.file("volume"),
            .isovalue = shape.number("isovalue", kRequired),
            .interpolation = shape.choice<Interpolation>(
                "interpolation", Interpolation::trilinear,
                {{"trilinear", Interpolation::trilinear}, {"catmull-rom", Interpolation::catmull_rom}})};
    if (kind == "rectangle") {
        RectangleShape rectangle;
        read_frame(shape, rectangle.center, rectangle.u, rectangle.v);
        if (shape.has("image")) rectangle.image = shape.file("image");
        return rectangle;
    }
    SliceShape slice;
    slice.volume = shape.file("volume");
    read_frame(shape, slice.center, slice.u, slice.v);
    slice.transfer = read_transfer(shape);
    return slice;
}

std::vector<Contour> read_contours(const ConfigTable& table) {
    std::vector<Contour> contours;
    for (const ConfigTable& entry : table.tables("contours")) {
        Contour contour{.field = entry.text("field", kRequired),
                        .spacing = entry.number("spacing", kRequired, above(0)),
                        .width_px = entry.number("width_px", 2.0, above(0)),
                        .color = entry.vec3("color", Vec3(0.0), kUnit)};
        if (contour.field.empty()) throw entry.error("field", "is empty, expected an expression");
        contours.push_back(std::move(contour));
    }
    return contours;
}

Surface read_surface(const ConfigTable& table, std::size_t index) {
    Surface surface;
    surface.name = read_name(table, fmt::format("surface {}", index));
    surface.shape = read_shape(table);
    if (table.has("bounds")) surface.bounds = read_bounds(table);
    if (!surface.bounds && std::holds_alternative<ExpressionShape>(surface.shape))
        throw table.error("bounds", "are missing, an expression needs them: [[x0, y0, z0], [x1, y1, z1]]");
    surface.color = table.vec3("color", surface.color, kUnit);
    surface.opacity = table.number("opacity", surface.opacity, kUnit);
    surface.opacity_law =
        table.choice<OpacityLaw>("opacity_law", OpacityLaw::constant,
                                 {{"constant", OpacityLaw::constant}, {"oblique", OpacityLaw::oblique}});
    surface.shading = read_shading(table, surface.shading);
    if (table.has("thickness") && table.kind("thickness") != ValueKind::string)
        surface.thickness = table.number("thickness", kRequired, at_least(0));
    else
        table.one_of("thickness", "auto", {"auto"});
    surface.to_world = read_placement(table);
    surface.clip = read_clip(table);
    surface.contours = read_contours(table);
    return surface;
}

// ---- volumes

Volume read_volume_table(const ConfigTable& table, std::size_t index) {
    Volume volume;
    volume.name = read_name(table, fmt::format("volume {}", index));
    if (table.has("file") == table.has("expression"))
        throw table.error("", table.has("file") ? "has file and expression, expected one of them"
                                                : "has neither file nor expression, expected one of them");
    if (table.has("file")) {
        volume.source = table.file("file");
        for (const char* key : {"bounds", "resolution"})
            if (table.has(key)) throw table.error(key, "belongs to expression, not to file");
    } else {
        ExpressionVolume formula;
        formula.text = table.text("expression", kRequired);
        if (formula.text.empty()) throw table.error("expression", "is empty");
        if (!table.has("bounds"))
            throw table.error("bounds",
                              "are missing, an expression needs them: [[x0, y0, z0], [x1, y1, z1]]");
        formula.bounds = read_bounds(table);
        // At least two samples an axis: both ends of the bounds are sampled.
        const IntegerRange samples{2, kMaxSide};
        const auto sizes = table.kind("resolution") == ValueKind::array
                               ? table.integers("resolution", kRequired, samples, exactly(3))
                               : std::vector(3, table.integer("resolution", kRequired, samples));
        if (sizes[0] * sizes[1] * sizes[2] > kMaxVoxels)
            throw table.error("resolution", fmt::format("= [{}], expected at most {} voxels",
                                                        fmt::join(sizes, ", "), kMaxVoxels));
        for (std::size_t i = 0; i < 3; ++i) formula.resolution[i] = static_cast<int>(sizes[i]);
        volume.source = std::move(formula);
    }
    volume.transfer = read_transfer(table);
    if (table.has("opacity_step") && table.kind("opacity_step") != ValueKind::string)
        volume.opacity_step = table.number("opacity_step", kRequired, above(0));
    else
        table.one_of("opacity_step", "voxel", {"voxel"});
    volume.interpolation = table.choice<Interpolation>("interpolation", Interpolation::trilinear,
                                                       {{"trilinear", Interpolation::trilinear},
                                                        {"catmull-rom", Interpolation::catmull_rom},
                                                        {"nearest", Interpolation::nearest}});
    volume.shading = read_shading(table, volume.shading);
    volume.to_world = read_placement(table);
    volume.clip = read_clip(table);
    return volume;
}

}  // namespace

Scene scene_from_config(const Config& config) {
    const ConfigTable root = config.root();
    Scene scene;
    scene.source = config.source();
    scene.image = read_image(root);
    scene.camera = read_camera(root);
    scene.lights = read_lights(root);

    std::set<std::string> names;
    const auto claim = [&names](const ConfigTable& table, const std::string& name) {
        if (!names.insert(name).second)
            throw table.error("name", fmt::format("= \"{}\" is taken by another object", one_line(name, 60)));
    };
    for (const ConfigTable& table : root.tables("surface")) {
        scene.surfaces.push_back(read_surface(table, scene.surfaces.size()));
        claim(table, scene.surfaces.back().name);
    }
    for (const ConfigTable& table : root.tables("volume")) {
        scene.volumes.push_back(read_volume_table(table, scene.volumes.size()));
        claim(table, scene.volumes.back().name);
    }
    return scene;
}

Scene load_scene(const std::filesystem::path& file, std::span<const std::string> overrides) {
    Config config = Config::read(file);
    for (const std::string& assignment : overrides) config.apply_override(assignment);
    Scene scene = scene_from_config(config);
    config.finish();
    return scene;
}

bool is_scene_override(std::string_view assignment) {
    const std::string_view first = assignment.substr(0, assignment.find_first_of(".="));
    constexpr std::array<std::string_view, 5> kTables{"image", "camera", "light", "surface", "volume"};
    return std::find(kTables.begin(), kTables.end(), first) != kTables.end();
}

}  // namespace pellucid
