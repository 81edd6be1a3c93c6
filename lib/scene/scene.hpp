// What is to be drawn: the scene file's contents as plain values.
//
// Lengths in scene units, angles in degrees, colours linear. Nothing is loaded yet: paths are
// absolute or relative to the working directory (the loader resolved them beside the scene file).
#pragma once

#include <array>
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "core/vec.hpp"
#include "field/volume_field.hpp"

namespace pellucid {

struct ImageSettings {
    int width = 0;
    int height = 0;
    Vec3 background{0.0};
};

enum class Projection { perspective, orthographic };

/// Right-handed world: right = (target − position) × up. Square pixels; row 0 is on top.
struct CameraSettings {
    Projection projection = Projection::perspective;
    Vec3 position{0.0};
    Vec3 target{0.0};
    Vec3 up{0, 1, 0};
    double fov_degrees = 30;   // vertical, perspective only
    double view_height = 2;    // orthographic only
    std::optional<double> near = {};  // along the view axis; from the scene when absent
    std::optional<double> far = {};
};

struct Light {
    bool headlight = false;    // towards the viewer, per point; then `direction` is not used
    Vec3 direction{0, 0, 1};   // towards the light, world; unit length
    double intensity = 1;
};

/// Blinn-Phong without clamp; `flat` = the colour as it is.
struct Shading {
    bool flat = false;
    double ambient = 0.2;
    double diffuse = 0.8;
    double specular = 0.0;
    double shininess = 32;
};

/// Keeps normal·x <= offset, in world coordinates; normal need not have unit length.
struct ClipPlane {
    Vec3 normal{0.0};
    double offset = 0;
};

struct Contour {
    std::string field;
    double spacing = 0;
    double width_px = 0;
    Vec3 color{0.0};
};

/// value, r, g, b, opacity; values do not fall, a repeated value is a jump.
using TransferPoint = std::array<double, 5>;

struct ImplicitShape {       // of the catalogue: field/catalogue.hpp
    std::string name;
    std::map<std::string, double> parameters;
};
struct ExpressionShape {
    std::string text;
};
struct IsosurfaceShape {
    std::filesystem::path volume;
    double isovalue = 0;
    Interpolation interpolation = Interpolation::trilinear;
};
struct MeshShape {
    std::filesystem::path file;
};
struct PointsShape {
    std::filesystem::path file;
};
struct RectangleShape {      // u, v: half-edges, not parallel
    Vec3 center{0.0}, u{1, 0, 0}, v{0, 1, 0};
    std::optional<std::filesystem::path> image;
};
struct SliceShape {
    std::filesystem::path volume;
    Vec3 center{0.0}, u{1, 0, 0}, v{0, 1, 0};
    std::vector<TransferPoint> transfer;
};
using Shape = std::variant<ImplicitShape, ExpressionShape, IsosurfaceShape, MeshShape, PointsShape,
                           RectangleShape, SliceShape>;

/// How the opacity of one crossing depends on θ, the angle between geometric normal and pixel ray.
enum class OpacityLaw {
    constant,  // the same at every angle
    oblique,   // 1 − (1 − opacity)^(1/|cosθ|): what uniform particles do by nature
};

struct Surface {
    std::string name;
    Shape shape;
    std::optional<Box> bounds;            // object space; what lies outside is cut away
    Vec3 color{0.8, 0.8, 0.8};
    double opacity = 1;                   // of one crossing, seen straight on
    OpacityLaw opacity_law = OpacityLaw::constant;
    Shading shading;
    std::optional<double> thickness;      // virtual slab, scene units; absent = "auto"
    Affine to_world;                      // invertible
    std::vector<ClipPlane> clip;
    std::vector<Contour> contours;
};

/// Samples of a formula at both ends of `bounds`: spacing = length/(resolution − 1).
struct ExpressionVolume {
    std::string text;
    Box bounds;
    std::array<int, 3> resolution{};
};

struct Volume {
    std::string name;
    std::variant<std::filesystem::path, ExpressionVolume> source;
    std::vector<TransferPoint> transfer;
    std::optional<double> opacity_step;   // absent = "voxel", the smallest world spacing
    Interpolation interpolation = Interpolation::trilinear;
    Shading shading{.flat = true};
    Affine to_world;                      // on top of the file's own placement
    std::vector<ClipPlane> clip;
};

struct Scene {
    std::string source;                   // for messages: the file's name
    ImageSettings image;
    CameraSettings camera;
    std::vector<Light> lights;            // never empty: the loader adds the headlight
    std::vector<Surface> surfaces;
    std::vector<Volume> volumes;
};

}  // namespace pellucid
