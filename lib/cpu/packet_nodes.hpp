// What collecting slabs in lanes keeps of the rays of a packet.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

#include "stage/slab_compression.hpp"

namespace pellucid {

/// Side of a packet in pixels.
inline constexpr int kPacketSide = 4;
inline constexpr std::size_t kPacketRays = kPacketSide * kPacketSide;

using PacketRow = std::array<float, kPacketRays>;

/// SlabCollector::Node field by field.
struct RayNodes {
    enum Field : std::uint8_t { z, d, r, g, b, a, before, error, fields };
    static constexpr std::size_t most = 16;
    // Room to read the next one of each in a whole vector.
    alignas(64) std::array<std::array<float, most + 8>, fields> rows;
};

struct PacketNodes {
    std::uint32_t room;  // nodes a ray, <= RayNodes::most
    std::array<RayNodes, kPacketRays> rays;
    alignas(64) PacketRow tolerance;
    alignas(64) std::array<std::int32_t, kPacketRays> seen;  // slabs that came
    std::array<std::int32_t, kPacketRays> count;             // closed nodes; -1: no slab came
    PacketRow nearest;                                       // front of the first slab

    void start(std::uint32_t nodes_a_ray, float negligible) {
        room = nodes_a_ray;
        tolerance.fill(negligible);
        count.fill(-1);
    }
};

}  // namespace pellucid
