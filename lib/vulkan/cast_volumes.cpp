#include "vulkan/cast_volumes.hpp"

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>

#include "core/error.hpp"
#include "core/parallel.hpp"
#include "cpu/packed_volume.hpp"

namespace pellucid::vulkan {
namespace {

constexpr std::uint32_t kRaysWords[] = {
#include "shaders/cast_rays.comp.inc"
};

static_assert(sizeof(twin::TransferPiece) == 48 && sizeof(twin::CastLight) == 20 &&
              sizeof(twin::VolumeRay) == 32 && sizeof(twin::PacketRay) == 24 &&
              sizeof(twin::RaySteps) == 16 && sizeof(twin::CastPlane) == 32);
static_assert(offsetof(twin::CastVolume, shading) == 120 && offsetof(twin::CastVolume, samples) == 240 &&
              sizeof(twin::CastVolume) == 272);
static_assert(sizeof(twin::CastCamera) == 168 && offsetof(twin::CastSetup, volumes) == 184);
static_assert(twin::kSamplesFloats == static_cast<std::uint32_t>(PackedVolume::Kind::floats));

struct RaysPush {
    std::uint64_t setup;
    std::uint32_t first, count, part;
};

/// Rays that keep a device busy, and whose states take little memory; what a real GPU computes within its
/// time limit.
constexpr std::uint32_t kBandRays = 1U << 20U;
constexpr std::uint32_t kBandRaysInSoftware = 1U << 16U;

/// Of a transfer function, by a ray.
constexpr std::uint32_t kMostKeptPieces = 8;

[[nodiscard]] std::size_t wide(int n) {
    return static_cast<std::size_t>(n);
}

[[nodiscard]] twin::Vec3f narrow(const Vec3& v) {
    return {static_cast<float>(v.x), static_cast<float>(v.y), static_cast<float>(v.z)};
}

/// The samples of cells, less the least one: of cell (i, j, k) the four at its lower z as one word, x
/// fastest.
template <class Word, class Sample>
[[nodiscard]] std::vector<Word> cell_words(const VoxelGrid& grid, double least) {
    std::vector<Word> words(grid.values.size());
    const auto offset = static_cast<float>(least);
    parallel_for(wide(grid.size[1]) * wide(grid.size[2]), 16, [&](std::size_t begin, std::size_t end) {
        for (std::size_t row = begin; row < end; ++row) {
            const int j = static_cast<int>(row % wide(grid.size[1])),
                      k = static_cast<int>(row / wide(grid.size[1]));
            const float* near = &grid.values[grid.index(0, j, k)];
            const float* far = &grid.values[grid.index(0, std::min(j + 1, grid.size[1] - 1), k)];
            const auto word = [&](const float* v, int i) {
                return static_cast<Word>(static_cast<Sample>(v[i] - offset));
            };
            constexpr int kBits = 8 * sizeof(Sample);
            for (int i = 0; i < grid.size[0]; ++i) {
                const int next = std::min(i + 1, grid.size[0] - 1);
                words[row * wide(grid.size[0]) + wide(i)] = word(near, i) | word(near, next) << kBits |
                                                            word(far, i) << 2 * kBits |
                                                            word(far, next) << 3 * kBits;
            }
        }
    });
    return words;
}

[[nodiscard]] std::vector<twin::TransferPiece> pieces_of(const PackedTransfer& t) {
    std::vector<twin::TransferPiece> pieces;
    for (std::size_t k = 0; k < t.count; ++k)
        pieces.push_back({t.begin[k], t.end[k], t.base[k], t.opacity[k], t.opacity_slope[k], t.color[0][k],
                          t.color[1][k], t.color[2][k], t.color_slope[0][k], t.color_slope[1][k],
                          t.color_slope[2][k], 0});
    return pieces;
}

[[nodiscard]] twin::CastShading shading_of(const VolumeObject& volume) {
    const Shading& s = volume.settings().shading;
    twin::CastShading shading{};
    shading.ambient = static_cast<float>(s.ambient);
    shading.diffuse = static_cast<float>(s.diffuse);
    shading.specular = static_cast<float>(s.specular);
    shading.shininess = static_cast<float>(s.shininess);
    // −∇f in the world, of any length.
    double largest = 0;
    std::array<Vec3, 3> columns;
    for (std::size_t a = 0; a < 3; ++a) {
        Vec3 unit(0.0);
        unit[static_cast<int>(a)] = -1;
        columns[a] = volume.to_world().normal(unit);
        for (int c = 0; c < 3; ++c) largest = std::max(largest, std::abs(columns[a][c]));
    }
    const auto row = [&](int c) {
        return narrow(Vec3(columns[0][c] / largest, columns[1][c] / largest, columns[2][c] / largest));
    };
    shading.row0 = row(0);
    shading.row1 = row(1);
    shading.row2 = row(2);
    return shading;
}

}  // namespace

bool has_holes(const VoxelGrid& grid) {
    std::atomic<bool> found{false};
    parallel_for(grid.values.size(), std::size_t{1} << 18U, [&](std::size_t begin, std::size_t end) {
        if (!std::all_of(grid.values.begin() + static_cast<std::ptrdiff_t>(begin),
                         grid.values.begin() + static_cast<std::ptrdiff_t>(end),
                         [](float v) { return v == v; }))
            found = true;
    });
    return found;
}

std::vector<twin::CastLight> lights_of(const PreparedScene& scene) {
    std::vector<twin::CastLight> lights;
    for (const Light& light : scene.settings.lights)
        lights.push_back(
            {narrow(light.direction), static_cast<float>(light.intensity), light.headlight ? 1U : 0U});
    return lights;
}

twin::CastCamera camera_of(const Camera& camera, double step, int rays) {
    return {.eye = twin_of(camera.eye()),
            .right = twin_of(camera.world_vector({1, 0, 0})),
            .down = twin_of(camera.world_vector({0, 1, 0})),
            .forward = twin_of(camera.forward()),
            .center_x = camera.center().x,
            .center_y = camera.center().y,
            .pixel_size = camera.pixel_size(),
            .near = camera.near(),
            .far = camera.far(),
            .step = step,
            .width = camera.width(),
            .height = camera.height(),
            .perspective = camera.perspective() ? 1U : 0U,
            .rays = static_cast<std::uint32_t>(rays),
            .most_rounds = ~0U,
            .unused = 0};
}

twin::CastPlace place_of(const Affine& to_index, const Vec3& last) {
    return {twin_of(to_index.linear[0]), twin_of(to_index.linear[1]), twin_of(to_index.linear[2]),
            twin_of(to_index.offset), twin_of(last)};
}

std::vector<twin::CastPlane> planes_of(std::span<const ClipPlane> planes) {
    std::vector<twin::CastPlane> out;
    for (const ClipPlane& plane : planes) out.push_back({twin_of(plane.normal), plane.offset});
    return out;
}

std::uint32_t cast_group_size(const Device& device) {
    const std::uint32_t wished = device.info().is_gpu ? 64 : twin::kPacketRaysT;
    const std::uint32_t subgroup = std::max(twin::kPacketRaysT, device.info().subgroup_size);
    return (wished + subgroup - 1) / subgroup * subgroup;
}

std::uint32_t packets_of_row(const Camera& camera) {
    return (static_cast<std::uint32_t>(camera.width()) + twin::kPacketSideT - 1) / twin::kPacketSideT;
}
std::uint32_t packets_of_image(const Camera& camera) {
    return packets_of_row(camera) *
           ((static_cast<std::uint32_t>(camera.height()) + twin::kPacketSideT - 1) / twin::kPacketSideT);
}

std::uint32_t packets_of_band(const Device& device, const Camera& camera, std::uint32_t times) {
    const std::uint32_t most =
        (device.info().is_gpu ? kBandRays / times : kBandRaysInSoftware) / twin::kPacketRaysT;
    return std::min(std::max(most, packets_of_row(camera)), packets_of_image(camera));
}

CastVolumes::CastVolumes(const Device& device, const PreparedScene& scene,
                         std::span<const VolumeObject* const> volumes, const CastSettings& settings, int rays)
    : device_(&with_doubles(device)),
      group_size_(cast_group_size(device)),
      band_(packets_of_band(device, scene.camera)),
      rays_kernel_(device, kRaysWords,
                   {.push_bytes = sizeof(RaysPush), .constants = std::array{group_size_}}) {
    std::vector<twin::CastVolume> placed;
    for (const VolumeObject* volume : volumes) placed.push_back(place_on_device(*volume, settings));
    const std::vector<twin::CastLight> lights = lights_of(scene);
    placed.resize(std::max<std::size_t>(1, placed.size()));  // rays that meet nothing, where there is none
    volumes_ = filled(device, placed);
    status_ = Buffer(device, twin::kStatusWords * sizeof(std::uint32_t));
    lights_ = filled(device, lights);
    const std::uint64_t band_rays = std::uint64_t{band_} * twin::kPacketRaysT;
    packet_rays_ = Buffer(device, band_rays * sizeof(twin::PacketRay));
    volume_rays_ = Buffer(device, band_rays * placed.size() * sizeof(twin::VolumeRay));
    ray_steps_ = Buffer(device, band_rays * sizeof(twin::RaySteps));
    setup_ = Buffer(device, sizeof(twin::CastSetup));
    setup.camera = camera_of(scene.camera, settings.step, rays);
    setup.volume_count = static_cast<std::uint32_t>(volumes.size());
    setup.light_count = static_cast<std::uint32_t>(lights.size());
    setup.packet_columns = packets_of_row(scene.camera);
    setup.volumes = volumes_.address();
    setup.lights = lights_.address();
    setup.packet_rays = packet_rays_.address();
    setup.volume_rays = volume_rays_.address();
    setup.ray_steps = ray_steps_.address();
    setup.status = status_.address();
    bytes_ = packet_rays_.bytes() + volume_rays_.bytes() + ray_steps_.bytes();
    for (const Held& held : held_)
        bytes_ += held.samples.bytes() + held.pieces.bytes() + held.distance.bytes() + held.planes.bytes();
}

twin::CastVolume CastVolumes::place_on_device(const VolumeObject& volume, const CastSettings& settings) {
    const PackedVolume packed(volume, settings.skip, false);
    const VoxelGrid& grid = volume.field().grid();
    Held held;
    switch (packed.kind) {
        case PackedVolume::Kind::bytes:
            held.samples = filled(*device_, cell_words<std::uint32_t, std::uint8_t>(grid, packed.offset));
            break;
        case PackedVolume::Kind::words:
            held.samples = filled(*device_, cell_words<std::uint64_t, std::uint16_t>(grid, packed.offset));
            break;
        case PackedVolume::Kind::floats:
            held.samples = filled(*device_, std::span<const float>(grid.values));
            holes_ = holes_ || has_holes(grid);
            break;
    }
    held.pieces = filled(*device_, pieces_of(packed.transfer));
    held.planes = filled(*device_, planes_of(volume.settings().clip));
    std::vector<std::uint8_t> distance = packed.space.distance();
    distance.resize((distance.size() + 3) / 4 * 4);  // read as words
    held.distance = filled(*device_, distance);

    const auto kind = static_cast<std::uint32_t>(packed.kind);
    const Shading& shading = volume.settings().shading;
    kinds_ |= 1U << kind;
    lit_ = lit_ || !shading.flat;
    glossy_ = glossy_ || (!shading.flat && shading.specular != 0);
    skip_ = skip_ || !distance.empty();
    twin::CastVolume v{};
    v.place = place_of(volume.to_index(), volume.field().hull().hi);
    v.shading = shading_of(volume);
    v.last = {packed.last[0], packed.last[1], packed.last[2]};
    v.last_cell_x = packed.last_cell[0];
    v.last_cell_y = packed.last_cell[1];
    v.last_cell_z = packed.last_cell[2];
    v.row = static_cast<std::uint32_t>(grid.size[0]);
    v.slice = v.row * static_cast<std::uint32_t>(grid.size[1]);
    v.blocks_x = packed.space.blocks()[0];
    v.blocks_y = packed.space.blocks()[1];
    v.blocks_z = packed.space.blocks()[2];
    v.anything = packed.space.anything() ? 1 : 0;
    v.kind = kind;
    v.piece_count = packed.transfer.count;
    most_pieces_ = std::max(most_pieces_, packed.transfer.count);
    v.steps = static_cast<float>(std::min(settings.step / volume.opacity_step(), 1e30));
    // 0.6: then the series of depth_of_opacities() holds for any two of them, with room for float32.
    double most = 0;
    for (const TransferPoint& point : volume.settings().transfer) most = std::max(most, point[4]);
    if (most > 0.6) extremes_ |= 1U;
    if (-std::log1p(-std::min(most, 1.0)) * static_cast<double>(v.steps) > 4.9) extremes_ |= 2U;
    v.plane_count = static_cast<std::uint32_t>(volume.settings().clip.size());
    v.lit = shading.flat ? 0 : 1;
    v.samples = held.samples.address();
    v.pieces = held.pieces.address();
    v.distance = held.distance.address();
    v.planes = held.planes.address();
    held_.push_back(std::move(held));
    return v;
}

std::vector<std::uint32_t> CastVolumes::constants(SlabMixing mixing) const {
    // Registers instead of a cache pay where a device is none.
    const std::uint32_t pieces = device_->info().is_gpu || most_pieces_ > kMostKeptPieces ? 0 : most_pieces_;
    return {group_size_,       kinds_,           lit_ ? 1U : 0U,  glossy_ ? 1U : 0U,
            setup.light_count, holes_ ? 1U : 0U, skip_ ? 1U : 0U, static_cast<std::uint32_t>(mixing),
            pieces,            std::max(1U, setup.volume_count), extremes_};
}

void CastVolumes::record_rays(Commands& commands, std::uint32_t first, std::uint32_t count,
                              std::uint32_t part) const {
    commands.dispatch(rays_kernel_, RaysPush{setup_.address(), first, count, part},
                      device_->groups_for(std::uint64_t{count} * twin::kPacketRaysT, group_size_));
}

void CastVolumes::begin(Commands& commands) const {
    upload(*device_, setup_, std::as_bytes(std::span(&setup, 1)));
    commands.fill(status_, 0, status_.bytes(), 0);
    if (setup.volume_count == 0) commands.fill(volume_rays_, 0, volume_rays_.bytes(), 0);
    commands.barrier();
}

std::uint32_t CastVolumes::check() const {
    return check_status(*device_, status_);
}

std::uint32_t check_status(const Device& device, const Buffer& status) {
    std::array<std::uint32_t, twin::kStatusWords> words{};
    download(device, status, std::as_writable_bytes(std::span(words)));
    if (words[0] != 0)
        throw run_error("{}: a ray takes more steps than Vulkan in software walks: a larger step is needed",
                        device.info().name);
    return words[1];
}

const Device& with_doubles(const Device& device) {
    if (!device.info().float64)
        throw Error(Failure::device, fmt::format("Vulkan device \"{}\" casts no rays: it lacks shaderFloat64",
                                                 device.info().name));
    return device;
}

}  // namespace pellucid::vulkan
