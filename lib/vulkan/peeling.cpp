#include "vulkan/peeling.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>
#include <mutex>
#include <numeric>

#include "core/error.hpp"
#include "core/parallel.hpp"
#include "cpu/rasterizer.hpp"
#include "stage/virtual_slab.hpp"

namespace pellucid::vulkan {
namespace {

constexpr std::uint32_t kVertexWords[] = {
#include "shaders/peel.vert.inc"
};
constexpr std::uint32_t kFragmentWords[] = {
#include "shaders/peel.frag.inc"
};
constexpr std::uint32_t kShadeWords[] = {
#include "shaders/peel_shade.comp.inc"
};

static_assert(sizeof(Vec3) == sizeof(twin::Vec3d) && sizeof(DepthPlane) == sizeof(twin::PeelPlane));
static_assert(sizeof(SurfaceFragment) == sizeof(twin::PaintedFragment) && sizeof(twin::PaintedFragment) == 32);
static_assert(sizeof(twin::PeelPixel) == 24 && sizeof(twin::PeelColor) == 40 && sizeof(twin::PeelPart) == 32);
static_assert(sizeof(twin::PeelLight) == 20 && sizeof(twin::PeelObject) == 272 && sizeof(twin::PeelFlags) == 20);
static_assert(sizeof(twin::PeelDrawPush) == 128 && sizeof(twin::PeelShadePush) == 128);

enum class Output : std::uint32_t { targets, mixed, blended };

/// Triangles that are set up at a time, as on the CPU.
constexpr std::size_t kPiece = 8192;
/// Largest viewport: with 8 bits below the pixel its places are whole numbers of 22 bits, exact as floats.
constexpr std::uint32_t kMostSide = 1U << 14U;
constexpr std::uint32_t kGridBits = 8;
static_assert(1 << kGridBits == kSubpixels);
/// Of the heap, what pixels may take; larger images are drawn a band of rows after the other.
constexpr std::uint64_t kHeapShare = 4;
constexpr std::uint64_t kMostPixelBytes = std::uint64_t{1} << 30U;
/// Of an invocation that shades: workgroups cost more than pixels in software; from 32 on there is nothing to gain.
constexpr std::uint64_t kMostPixelsEach = 32;
/// Vulkan in software leaves every loop of an invocation after 65535 rounds (particles.cpp): slots times lights, and what
/// is unrolled or not at the compiler's choice.
constexpr std::uint64_t kMostIterations = 60000;
constexpr std::uint64_t kIterationsASlot = 12;
/// Where more fragments than M are at one depth: so many bytes a pixel are no more than 128 layers.
constexpr int kMostSlots = 128;

template <class T>
[[nodiscard]] std::span<const std::byte> bytes_of(const std::vector<T>& values) {
    return std::as_bytes(std::span(values));
}
[[nodiscard]] twin::Vec3d wide(const Vec3& v) { return {v.x, v.y, v.z}; }
[[nodiscard]] float narrow(double v) { return static_cast<float>(v); }

[[nodiscard]] std::uint64_t pixel_room(const Device& device) {
    return std::min(device.info().heap_bytes / kHeapShare, kMostPixelBytes);
}

/// All parts of the triangles of a scene, by number, and the planes of their triangles.
struct Parts {
    std::vector<twin::PeelPart> parts;
    std::vector<DepthPlane> planes;
    std::vector<std::uint32_t> first;  // of an object, and the number of all
};

/// A part that the device's rasteriser covers as the CPU's does: within the viewport.
struct WholeWithin {
    std::int32_t left, top, side;  // on the grid; side 0: none
    [[nodiscard]] bool operator()(const twin::PeelPart& p) const {
        const auto [x_lo, x_hi] = std::minmax({p.x0, p.x1, p.x2});
        const auto [y_lo, y_hi] = std::minmax({p.y0, p.y1, p.y2});
        return side > 0 && x_lo >= left && x_hi <= left + side && y_lo >= top && y_hi <= top + side;
    }
};

[[nodiscard]] Parts set_up(const Camera& camera, const SceneMeshes& meshes, const std::vector<bool>& shows) {
    const TriangleSetup setup(camera);
    struct Piece {
        std::size_t object, begin, end;
        std::vector<twin::PeelPart> parts = {};
        std::vector<DepthPlane> planes = {};
    };
    std::vector<Piece> pieces;
    for (std::size_t o = 0; o < meshes.objects().size(); ++o) {
        const std::size_t count = shows[o] ? meshes.objects()[o].mesh->triangles.size() : 0;
        for (std::size_t begin = 0; begin < count; begin += kPiece) pieces.push_back({o, begin, std::min(begin + kPiece, count)});
    }
    parallel_for(pieces.size(), 1, [&](std::size_t first, std::size_t last) {
        std::vector<RasterTriangle> found;
        for (std::size_t p = first; p < last; ++p) {
            Piece& piece = pieces[p];
            const ObjectMesh& object = meshes.objects()[piece.object];
            for (std::size_t i = piece.begin; i < piece.end; ++i) {
                const auto& [a, b, c] = object.mesh->triangles[i];
                const std::array<Vec3, 3> view{object.view[a], object.view[b], object.view[c]};
                found.clear();
                setup.add(view, {setup.snap(view[0]), setup.snap(view[1]), setup.snap(view[2])},
                          meshes.first_triangle(piece.object) + static_cast<std::uint32_t>(i), found);
                if (found.empty()) continue;
                const DepthPlane plane = depth_plane(camera, view[0], view[1], view[2]);
                for (const RasterTriangle& t : found) {
                    piece.parts.push_back({t.x[0], t.x[1], t.x[2], t.y[0], t.y[1], t.y[2], t.number,
                                           static_cast<std::uint32_t>(piece.object)});
                    piece.planes.push_back(plane);
                }
            }
        }
    });

    Parts all;
    std::size_t count = 0;
    for (const Piece& piece : pieces) count += piece.parts.size();
    if (count > std::numeric_limits<std::uint32_t>::max() / 3)
        throw run_error("{} triangles in the image, at most {} on Vulkan", count, std::numeric_limits<std::uint32_t>::max() / 3);
    all.parts.reserve(count);
    all.planes.reserve(count);
    all.first.assign(meshes.objects().size() + 1, 0);
    for (Piece& piece : pieces) {
        all.first[piece.object + 1] += static_cast<std::uint32_t>(piece.parts.size());
        all.parts.insert(all.parts.end(), piece.parts.begin(), piece.parts.end());
        all.planes.insert(all.planes.end(), piece.planes.begin(), piece.planes.end());
        piece = {};
    }
    std::partial_sum(all.first.begin(), all.first.end(), all.first.begin());
    return all;
}

/// Pixels that an object's parts may cover.
[[nodiscard]] PixelRect rectangle_of(const Parts& parts, std::size_t object, const PixelRect& image) {
    PixelRect r{image.x1, image.y1, image.x0, image.y0};
    for (std::uint32_t i = parts.first[object]; i < parts.first[object + 1]; ++i) {
        const twin::PeelPart& p = parts.parts[i];
        const PixelRect own = centers_within({{p.x0, p.x1, p.x2}, {p.y0, p.y1, p.y2}, 0}, image);
        r = {std::min(r.x0, own.x0), std::min(r.y0, own.y0), std::max(r.x1, own.x1), std::max(r.y1, own.y1)};
    }
    return r.x0 < r.x1 && r.y0 < r.y1 ? r : PixelRect{};
}

}  // namespace

class Peeler::State {
public:
    State(const Device& device, const PreparedScene& scene, const SceneMeshes& meshes, const PeelerSettings& settings)
        : device_(device),
          scene_(scene),
          meshes_(meshes),
          settings_(settings),
          slots_(settings.targets),
          group_size_(group_size(device)),
          commands_(device) {
        const Camera& camera = scene.camera;
        side_ = std::bit_floor(std::min(device.info().largest_viewport, kMostSide));
        require_fits(camera.width());

        std::vector<bool> shows;
        for (const ObjectMesh& mesh : meshes.objects()) shows.push_back(static_cast<float>(scene.objects[mesh.object].surface.opacity) > 0);
        Parts parts = set_up(camera, meshes, shows);
        first_part_ = parts.first;
        place_viewport();
        sort_out(parts);
        parts_ = filled(bytes_of(parts.parts));
        planes_ = filled(bytes_of(parts.planes));
        upload_objects(parts);
        upload_lights();
        fill_setup();
    }

    PeelStats run(std::span<const std::uint32_t> objects, const PeelSettings& settings, const PeelRows& rows, Output output,
                  const std::function<void(const PeeledTargets&)>& intermix) {
        choose(rows);
        ranked_ = !settings.order.empty();
        make_room(output);
        const Buffer order = filled(std::as_bytes(settings.order));
        draw_.order = order.address();
        setup_.most_clear = 1 - settings.opaque_at;
        setup_.most_layers = settings.layers > 0 ? static_cast<std::uint32_t>(settings.layers) : ~0U;
        const Work work = work_of(objects);
        start(output);

        PeelStats stats;
        while (!work.empty()) {
            const twin::PeelFlags flags = pass(work, stats.passes == 0);
            ++stats.passes;
            stats.fragments += flags.found;
            stats.pixels += flags.pixels;
            stats.layers = std::max<std::uint64_t>(stats.layers, flags.layers);
            if (flags.found > 0 && intermix) intermix({slabs_, numbers_, counts_, slots_});
            if (flags.stuck != 0) more_slots(output);
            if (flags.more == 0) break;
        }
        stats.bytes = device_.bytes_held();
        return stats;
    }

    std::span<const twin::PeelColor> compose(std::span<const std::uint32_t> objects, const PeelSettings& settings,
                                             PeelMix mix, const PeelRows& rows, PeelStats& stats) {
        stats = run(objects, settings, rows, mix == PeelMix::by_depth ? Output::mixed : Output::blended, {});
        if (colors_read_.bytes() != colors_.bytes()) colors_read_ = Buffer(device_, colors_.bytes(), BufferKind::readback);
        commands_.begin_stage("read-back");
        commands_.copy(colors_, 0, colors_read_, 0, colors_.bytes());
        commands_.end_stage();
        note(commands_.submit_and_wait());
        const std::span colors(reinterpret_cast<const twin::PeelColor*>(colors_read_.mapped().data()), pixels_);
        stats.bytes = device_.bytes_held();
        stats.fragments = 0;
        for (const twin::PeelColor& color : colors) {
            stats.fragments += color.count;
            stats.pixels += color.count > 0 ? 1 : 0;
            stats.layers = std::max<std::uint64_t>(stats.layers, color.count);
        }
        return colors;
    }

    [[nodiscard]] const std::vector<pellucid::StageTime>& times() const { return times_; }

    [[nodiscard]] PeelRows all_rows() const { return {0, scene_.camera.height()}; }
    [[nodiscard]] int most_rows() const {
        const auto a_row = static_cast<std::uint64_t>(scene_.camera.width()) *
                           (sizeof(twin::PeelPixel) + 2 * sizeof(twin::PeelColor) + 8 * static_cast<std::uint64_t>(slots_));
        return static_cast<int>(std::clamp<std::uint64_t>(pixel_room(device_) / a_row, 1, side_));
    }

private:
    void require_fits(int pixels) const {
        if (static_cast<std::uint32_t>(pixels) > side_)
            throw run_error("an image of {} x {} pixels: \"{}\" draws triangles in at most {} x {}", scene_.camera.width(),
                            scene_.camera.height(), device_.info().name, side_, side_);
    }

    /// The rows that are drawn next.
    void choose(const PeelRows& rows) {
        const int count = rows.end - rows.begin;
        require_fits(count);
        pixels_ = static_cast<std::size_t>(scene_.camera.width()) * static_cast<std::size_t>(count);
        setup_.first_row = draw_.first_row = rows.begin;
        setup_.rows = draw_.rows = count;
    }

    /// As much room on either side of the image; of images higher than the viewport, its uppermost rows.
    void place_viewport() {
        const auto side = static_cast<int>(side_);
        draw_.viewport_side = side;
        draw_.viewport_x = -(side - scene_.camera.width()) / 2;
        draw_.viewport_y = -std::max(0, side - scene_.camera.height()) / 2;
    }

    /// Parts that must be judged, object by object.
    void sort_out(Parts& parts) {
        const bool fine = device_.info().subpixel_bits == kGridBits && !settings_.judge_all;
        const WholeWithin whole{kSubpixels * draw_.viewport_x, kSubpixels * draw_.viewport_y,
                                fine ? kSubpixels * draw_.viewport_side : 0};
        std::vector<std::uint32_t> judged;
        for (std::size_t o = 0; o + 1 < parts.first.size(); ++o) {
            first_judged_.push_back(static_cast<std::uint32_t>(judged.size()));
            for (std::uint32_t i = parts.first[o]; i < parts.first[o + 1]; ++i) {
                if (whole(parts.parts[i])) continue;
                parts.parts[i].object |= twin::kPeelJudged;
                judged.push_back(i);
            }
        }
        first_judged_.push_back(static_cast<std::uint32_t>(judged.size()));
        judged_ = filled(bytes_of(judged));
    }

    /// As many as run in step in software; a GPU is kept busy by any.
    [[nodiscard]] static std::uint32_t group_size(const Device& device) {
        return device.info().is_gpu ? 64 : std::max(1U, device.info().subgroup_size);
    }

    [[nodiscard]] Buffer filled(std::span<const std::byte> bytes) const {
        Buffer buffer(device_, bytes.size());
        upload(device_, buffer, bytes);
        return buffer;
    }

    /// Meshes one after the other in one buffer each for positions, normals and indices: a device has few allocations.
    void upload_objects(const Parts& parts) {
        std::uint64_t positions = 0, normals = 0, indices = 0;
        for (const ObjectMesh& object : meshes_.objects()) {
            positions += object.mesh->positions.size();
            normals += object.mesh->normals.size();
            indices += object.mesh->triangles.size();
        }
        positions_ = Buffer(device_, positions * sizeof(Vec3));
        normals_ = Buffer(device_, normals * sizeof(Vec3));
        indices_ = Buffer(device_, indices * 3 * sizeof(std::uint32_t));
        std::vector<double> clip;
        std::vector<SurfaceFragment> painted;
        std::vector<twin::PeelObject> objects;
        std::vector<std::size_t> first_painted, first_clip;
        std::uint64_t at_position = 0, at_normal = 0, at_index = 0;
        for (std::size_t o = 0; o < meshes_.objects().size(); ++o) {
            const ObjectMesh& mesh = meshes_.objects()[o];
            upload(device_, positions_, bytes_of(mesh.mesh->positions), at_position);
            upload(device_, normals_, bytes_of(mesh.mesh->normals), at_normal);
            upload(device_, indices_, bytes_of(mesh.mesh->triangles), at_index);
            twin::PeelObject& object = objects.emplace_back(describe(o));
            object.positions = positions_.address() + at_position;
            object.normals = normals_.address() + at_normal;
            object.triangles = indices_.address() + at_index;
            at_position += bytes_of(mesh.mesh->positions).size();
            at_normal += bytes_of(mesh.mesh->normals).size();
            at_index += bytes_of(mesh.mesh->triangles).size();

            first_clip.push_back(clip.size());
            for (const ClipPlane& plane : scene_.objects[mesh.object].surface.clip)
                clip.insert(clip.end(), {plane.normal.x, plane.normal.y, plane.normal.z, plane.offset});
            first_painted.push_back(painted.size());
            if ((object.flags & twin::kPeelPainted) != 0) paint(o, parts, object, painted);
            asks_.push_back((object.flags & (twin::kPeelPainted | twin::kPeelBounds)) != 0 || object.clip_count > 0);
            any_flag_ |= object.flags;
            any_lit_ = any_lit_ || (object.flags & twin::kPeelFlat) == 0;
        }
        clip_ = filled(bytes_of(clip));
        painted_ = filled(bytes_of(painted));
        for (std::size_t o = 0; o < objects.size(); ++o) {
            objects[o].clip = clip_.address() + first_clip[o] * sizeof(double);
            objects[o].painted = painted_.address() + first_painted[o] * sizeof(SurfaceFragment);
        }
        objects_ = filled(bytes_of(objects));
    }

    [[nodiscard]] twin::PeelObject describe(std::size_t o) const {
        const ObjectMesh& mesh = meshes_.objects()[o];
        const Object& object = scene_.objects[mesh.object];
        const Surface& surface = object.surface;
        twin::PeelObject d{};
        d.color = wide(surface.color);
        d.opacity = surface.opacity;
        d.optical_depth = -std::log1p(-surface.opacity);
        d.thickness = fixed_thickness(scene_, object).value_or(-1);
        d.ambient = narrow(surface.shading.ambient);
        d.diffuse = narrow(surface.shading.diffuse);
        d.specular = narrow(surface.shading.specular);
        d.shininess = narrow(surface.shading.shininess);
        d.first_triangle = meshes_.first_triangle(o);
        d.clip_count = static_cast<std::uint32_t>(surface.clip.size());
        if (surface.opacity_law == OpacityLaw::oblique) d.flags |= twin::kPeelOblique;
        if (surface.shading.flat) d.flags |= twin::kPeelFlat;
        if (!mesh.mesh->normals.empty()) d.flags |= twin::kPeelSmooth;
        if (mesh.of_field) d.flags |= twin::kPeelOfField;
        if (object.geometry->has_color() || object.geometry->painted()) d.flags |= twin::kPeelPainted;
        if (surface.bounds && !object.bounds_are_geometry()) {
            d.flags |= twin::kPeelBounds;
            d.lo = wide(surface.bounds->lo);
            d.hi = wide(surface.bounds->hi);
            d.to_object_x = wide(object.to_object.linear[0]);
            d.to_object_y = wide(object.to_object.linear[1]);
            d.to_object_z = wide(object.to_object.linear[2]);
            d.to_object_offset = wide(object.to_object.offset);
        }
        return d;
    }

    /// Fragments of an object whose colour the device cannot tell.
    void paint(std::size_t o, const Parts& parts, twin::PeelObject& object, std::vector<SurfaceFragment>& painted) const {
        const PixelRect r = rectangle_of(parts, o, {0, 0, scene_.camera.width(), scene_.camera.height()});
        object.painted_x = r.x0;
        object.painted_y = r.y0;
        object.painted_width = r.x1 - r.x0;
        const std::size_t first = painted.size();
        painted.resize(first + static_cast<std::size_t>(r.x1 - r.x0) * static_cast<std::size_t>(r.y1 - r.y0),
                       {{}, 0, PeelTarget::kNoFragment});
        const auto number = static_cast<std::uint32_t>(o);
        pellucid::peel(scene_, meshes_, {&number, 1}, {.thickness = settings_.thickness},
                       [&](int x, int y, std::span<const SurfaceFragment> fragments) {
                           const auto row = static_cast<std::size_t>(y - r.y0);
                           painted[first + row * static_cast<std::size_t>(r.x1 - r.x0) + static_cast<std::size_t>(x - r.x0)] =
                               fragments.front();
                       });
    }

    void upload_lights() {
        std::vector<twin::PeelLight> lights;
        for (const Light& light : scene_.settings.lights)
            lights.push_back({{narrow(light.direction.x), narrow(light.direction.y), narrow(light.direction.z)},
                              narrow(light.intensity),
                              light.headlight ? 1U : 0U});
        lights_ = filled(bytes_of(lights));
        setup_.light_count = static_cast<std::uint32_t>(lights.size());
    }

    void fill_setup() {
        const Camera& camera = scene_.camera;
        twin::PeelRays& rays = shade_.rays;
        rays.eye = wide(camera.eye());
        rays.axis_x = wide(camera.world_vector({1, 0, 0}));
        rays.axis_y = wide(camera.world_vector({0, 1, 0}));
        rays.axis_z = wide(camera.forward());
        rays.center_x = camera.center().x;
        rays.center_y = camera.center().y;
        rays.pixel_size = camera.pixel_size();
        rays_ = filled(std::as_bytes(std::span(&rays, 1)));
        setup_.parts = parts_.address();
        setup_.planes = planes_.address();
        setup_.objects = objects_.address();
        setup_.lights = lights_.address();
        setup_.width = camera.width();

        draw_.rays = rays_.address();
        draw_.parts = parts_.address();
        draw_.planes = planes_.address();
        draw_.objects = objects_.address();
        draw_.center_x = rays.center_x;
        draw_.center_y = rays.center_y;
        draw_.near_depth = camera.near();
        draw_.far_depth = camera.far();
        draw_.width = camera.width();
        draw_.judged = judged_.address();
        draw_.shift = settings_.shift;
    }

    /// Buffers and kernels for one kind of output, kept from one run to the next.
    void make_room(Output output) {
        const auto exactly = [&](Buffer& buffer, std::uint64_t bytes) {
            if (buffer.bytes() == bytes) return;
            buffer = Buffer();  // the old one first: both may not fit
            buffer = Buffer(device_, bytes);
        };
        const auto slots = static_cast<std::uint64_t>(slots_);
        exactly(states_, pixels_ * sizeof(twin::PeelPixel));
        exactly(places_, pixels_ * slots * sizeof(std::uint64_t));
        exactly(flags_, sizeof(twin::PeelFlags));
        exactly(setup_buffer_, sizeof(setup_));
        if (flags_read_.bytes() == 0) flags_read_ = Buffer(device_, sizeof(twin::PeelFlags), BufferKind::readback);
        if (output == Output::targets) {
            exactly(slabs_, pixels_ * slots * sizeof(twin::Slab));
            exactly(numbers_, pixels_ * slots * sizeof(std::uint32_t));
            exactly(counts_, pixels_ * sizeof(std::uint32_t));
        } else {
            exactly(colors_, pixels_ * sizeof(twin::PeelColor));
        }
        setup_.pixels = draw_.pixels = states_.address();
        setup_.slots = draw_.slots = places_.address();
        setup_.slot_count = static_cast<std::uint32_t>(slots_);
        shade_.setup = setup_buffer_.address();
        setup_.slabs = slabs_.address();
        setup_.numbers = numbers_.address();
        setup_.counts = counts_.address();
        setup_.colors = colors_.address();
        setup_.flags = flags_.address();

        if (!raster_ || raster_->slots != slots_ || raster_->ranked != ranked_) raster_.emplace(Raster{slots_, ranked_, {}});
        const std::uint32_t each = pixels_each();
        if (!shader_ || shader_->output != output || shader_->pixels_each != each) {
            const auto any = [&](std::uint32_t flag) { return (any_flag_ & flag) != 0 ? 1U : 0U; };
            const std::array<std::uint32_t, 8> constants{group_size_,
                                                         static_cast<std::uint32_t>(output),
                                                         each,
                                                         perspective(),
                                                         settings_.thickness ? 1U : 0U,
                                                         any(twin::kPeelPainted),
                                                         any(twin::kPeelSmooth),
                                                         any_lit_ ? 1U : 0U};
            shader_.emplace(Shader{output, each,
                                   Kernel(device_, kShadeWords, {.push_bytes = sizeof(shade_), .constants = constants})});
        }
    }

    /// Pixels that one invocation shades.
    [[nodiscard]] std::uint32_t pixels_each() const {
        if (device_.info().is_gpu) return 1;
        const std::uint64_t a_pixel = static_cast<std::uint64_t>(slots_) * (setup_.light_count + kIterationsASlot);
        if (a_pixel > kMostIterations)
            throw run_error("{}: {} lights and {} surfaces a pass are more than Vulkan in software shades", device_.info().name,
                            setup_.light_count, slots_);
        return static_cast<std::uint32_t>(std::min(kMostPixelsEach, kMostIterations / a_pixel));
    }

    [[nodiscard]] std::uint32_t perspective() const { return scene_.camera.perspective() ? 1 : 0; }
    /// Made when it is first needed.
    [[nodiscard]] const RasterKernel& raster_kernel(bool asks, bool judged, bool first) {
        std::optional<RasterKernel>& kernel = raster_->kernels[(asks ? 1U : 0U) | (judged ? 2U : 0U) | (first ? 4U : 0U)];
        if (kernel) return *kernel;
        const auto flag = [](bool value) { return value ? 1U : 0U; };
        const std::array<std::uint32_t, 6> constants{static_cast<std::uint32_t>(slots_), flag(asks), flag(judged), flag(ranked_),
                                                     perspective(), flag(first)};
        return kernel.emplace(device_, kVertexWords, kFragmentWords,
                              KernelSettings{.push_bytes = sizeof(draw_), .constants = constants});
    }

    /// More fragments are at one depth of a pixel than there are slots.
    void more_slots(Output output) {
        if (slots_ >= kMostSlots)
            throw run_error("more than {} surfaces are at one depth of a pixel: too many on Vulkan", kMostSlots);
        slots_ = std::min(2 * slots_, kMostSlots);
        make_room(output);
        upload_setup();
        commands_.fill(places_, 0, places_.bytes(), ~0U);
    }

    /// What a pass draws: parts whose fragments are all there, those of objects that must be asked, and judged ones.
    struct Work {
        std::vector<VertexRange> plain, asking, judged;
        [[nodiscard]] bool empty() const { return plain.empty() && asking.empty() && judged.empty(); }
    };
    [[nodiscard]] Work work_of(std::span<const std::uint32_t> objects) const {
        const auto add = [](std::vector<VertexRange>& ranges, std::uint32_t begin, std::uint32_t end) {
            if (begin == end) return;
            if (!ranges.empty() && ranges.back().first + ranges.back().count == 3 * begin) {
                ranges.back().count += 3 * (end - begin);
            } else {
                ranges.push_back({3 * begin, 3 * (end - begin)});
            }
        };
        Work work;
        for (const std::uint32_t o : objects) {
            add(work.judged, first_judged_[o], first_judged_[o + 1]);
            const bool all_judged = first_judged_[o + 1] - first_judged_[o] == first_part_[o + 1] - first_part_[o];
            if (!all_judged) add(asks_[o] ? work.asking : work.plain, first_part_[o], first_part_[o + 1]);
        }
        return work;
    }

    void upload_setup() { upload(device_, setup_buffer_, std::as_bytes(std::span(&setup_, 1))); }

    /// All pixels as if nothing were drawn.
    void start(Output output) {
        upload_setup();
        commands_.fill(states_, 0, states_.bytes(), 0);
        if (output != Output::targets) commands_.fill(colors_, 0, colors_.bytes(), 0);
        commands_.fill(places_, 0, places_.bytes(), ~0U);
        commands_.barrier();
    }

    [[nodiscard]] twin::PeelFlags pass(const Work& work, bool first) {
        const auto width = static_cast<std::uint32_t>(scene_.camera.width());
        const auto rows = static_cast<std::uint32_t>(draw_.rows);
        commands_.fill(flags_, 0, flags_.bytes(), 0);
        commands_.barrier();
        commands_.begin_stage("peel");
        const auto draw = [&](bool asks, bool judged, const twin::PeelDrawPush& push, std::span<const VertexRange> ranges) {
            if (!ranges.empty())
                commands_.draw(raster_kernel(asks, judged, first), std::as_bytes(std::span(&push, 1)),
                               {push.viewport_x, push.viewport_y - push.first_row, side_, width, rows}, ranges);
        };
        draw(false, false, draw_, work.plain);
        draw(true, false, draw_, work.asking);
        twin::PeelDrawPush on_rows = draw_;  // a triangle over the pixels of a part is never cut
        on_rows.viewport_y = draw_.first_row - (static_cast<int>(side_) - draw_.rows) / 2;
        draw(true, true, on_rows, work.judged);
        commands_.end_stage();
        commands_.barrier();
        commands_.begin_stage("shade");
        commands_.dispatch(shader_->kernel, shade_, device_.groups_for(pixels_, group_size_ * shader_->pixels_each));
        commands_.end_stage();
        commands_.barrier();
        commands_.copy(flags_, 0, flags_read_, 0, flags_.bytes());
        note(commands_.submit_and_wait());
        twin::PeelFlags flags;
        std::memcpy(&flags, flags_read_.mapped().data(), sizeof(flags));
        return flags;
    }

    void note(const std::vector<vulkan::StageTime>& times) {
        for (const vulkan::StageTime& t : times) {
            const auto known = std::find_if(times_.begin(), times_.end(), [&](const auto& each) { return each.name == t.name; });
            if (known == times_.end()) {
                times_.push_back({t.name, t.seconds});
            } else {
                known->device_s += t.seconds;
            }
        }
    }

    struct Raster {
        int slots;
        bool ranked;
        std::array<std::optional<RasterKernel>, 8> kernels;  // asks, judged, first: bits
    };
    struct Shader {
        Output output;
        std::uint32_t pixels_each;
        Kernel kernel;
    };

    const Device& device_;
    const PreparedScene& scene_;
    const SceneMeshes& meshes_;
    PeelerSettings settings_;
    int slots_;
    std::uint32_t group_size_;
    std::uint32_t side_ = 0;  // of the viewport
    std::size_t pixels_ = 0;
    std::vector<std::uint32_t> first_part_, first_judged_;  // of an object
    std::vector<bool> asks_;                                // whether a fragment of the object may be cut away
    std::uint32_t any_flag_ = 0;                            // of all objects
    bool any_lit_ = false;
    twin::PeelSetup setup_{};
    twin::PeelDrawPush draw_{};
    twin::PeelShadePush shade_{};
    Commands commands_;
    std::optional<Raster> raster_;
    std::optional<Shader> shader_;
    bool ranked_ = false;
    Buffer judged_;
    Buffer setup_buffer_, parts_, planes_, positions_, normals_, indices_, clip_, painted_, objects_, lights_, rays_;
    Buffer states_, places_, slabs_, numbers_, counts_, colors_, colors_read_, flags_, flags_read_;
    std::vector<pellucid::StageTime> times_;
};

Peeler::Peeler(const Device& device, const PreparedScene& scene, const SceneMeshes& meshes, const PeelerSettings& settings)
    : state_(std::make_unique<State>(device, scene, meshes, settings)) {}
Peeler::Peeler(Peeler&&) noexcept = default;
Peeler::~Peeler() = default;

PeelStats Peeler::peel(std::span<const std::uint32_t> objects, const PeelSettings& settings,
                       const std::function<void(const PeeledTargets&)>& intermix) {
    return state_->run(objects, settings, state_->all_rows(), Output::targets, intermix);
}

std::span<const twin::PeelColor> Peeler::compose(std::span<const std::uint32_t> objects, const PeelSettings& settings,
                                                 PeelMix mix, const PeelRows& rows, PeelStats& stats) {
    return state_->compose(objects, settings, mix, rows, stats);
}

int Peeler::most_rows() const { return state_->most_rows(); }

const std::vector<pellucid::StageTime>& Peeler::device_times() const { return state_->times(); }

std::int64_t planned_compose_bytes(const Device& device, const PreparedScene& scene, double triangles, double vertices,
                                   int targets) {
    const double pixels = static_cast<double>(scene.camera.width()) * scene.camera.height();
    const double bytes_a_pixel = sizeof(twin::PeelPixel) + 8.0 * targets + 2 * sizeof(twin::PeelColor);
    double painted = 0;
    for (const Object& object : scene.objects)
        if (object.geometry->has_color() || object.geometry->painted()) painted += pixels * sizeof(SurfaceFragment);
    // Parts with planes, indices; positions and normals; states, slots, colours and those that are read back.
    const double bytes = triangles * (sizeof(twin::PeelPart) + sizeof(DepthPlane) + 3 * sizeof(std::uint32_t)) +
                         vertices * 2 * sizeof(Vec3) + painted +
                         std::min(pixels * bytes_a_pixel, static_cast<double>(pixel_room(device)));
    return static_cast<std::int64_t>(bytes);
}

}  // namespace pellucid::vulkan
