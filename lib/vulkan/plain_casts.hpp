// Private to lib/vulkan: a volume or an isosurface as the shaders of cast_plain.glsl read it.
#pragma once

#include "kernel/plain_cast_twin.h"
#include "vulkan/cast_volumes.hpp"

namespace pellucid::vulkan {

/// So many times as long as in float32 a step takes in double, at least, on GPUs that have few units for it.
inline constexpr std::uint32_t kPlainTimes = 16;

/// In double; n × n rays a pixel.
class PlainCasts {
public:
    PlainCasts(const Device& device, const PreparedScene& scene, std::span<const VolumeObject* const> volumes,
               const CastSettings& settings, int rays);
    /// Precondition: IsosurfaceCaster::casts each of them. `thickness`: of their virtual slabs.
    PlainCasts(const Device& device, const PreparedScene& scene, std::span<const Object* const> objects,
               std::span<const double> thickness, const CastSettings& settings, int rays);

    /// Bits of the specialisation constants of cast_plain.glsl.
    [[nodiscard]] std::vector<std::uint32_t> constants() const;
    twin::CastSetup setup{};
    void begin(Commands& commands) const;
    /// After all has run: check_status().
    std::uint32_t check() const;
    [[nodiscard]] std::uint64_t address() const { return setup_.address(); }
    [[nodiscard]] std::uint32_t band() const { return band_; }
    [[nodiscard]] std::uint32_t group_size() const { return group_size_; }
    [[nodiscard]] std::uint64_t bytes() const { return bytes_; }

private:
    struct Held {
        Buffer samples, pieces, distance, planes;
    };
    void set_up(const PreparedScene& scene, const CastSettings& settings, int rays, std::size_t count);
    [[nodiscard]] twin::PlainGrid grid_on_device(const VolumeField& field, const Affine& to_world,
                                                 const Affine& to_index, const EmptySpace& space,
                                                 std::span<const ClipPlane> clip, const Shading& shading,
                                                 Held& held);

    const Device* device_;
    std::uint32_t group_size_, band_;
    std::uint32_t interpolations_ = 0;  // bit k: some field has it
    bool lit_ = false, glossy_ = false, holes_ = false;
    std::uint64_t bytes_ = 0;
    std::vector<Held> held_;
    Buffer setup_, status_, items_, lights_;
};

}  // namespace pellucid::vulkan
