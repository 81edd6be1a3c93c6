// Bare probes: what the machine gives to the inner loop of each stage with no renderer around it.
// Built for the machine at hand (-march=native); every speed goal is a ratio to one of them.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "io/mesh_file.hpp"
#include "vulkan/device.hpp"

namespace pellucid::bench {

/// Splatting: 16-byte points in random order into one size² buffer of 64 bits, the nearest wins.
class SplatProbe {
public:
    SplatProbe(std::size_t points, int size);
    /// Projects and splats all points, on all threads; returns how many.
    std::uint64_t run();

private:
    struct Point {
        float x, y, z;
        std::uint32_t payload;
    };
    void splat(const Point* points, std::size_t count);

    int size_;
    std::vector<Point> points_;
    std::vector<std::uint64_t> keys_;
};

/// The same on Vulkan: one point an invocation, one 64-bit minimum.
class VulkanSplatProbe {
public:
    VulkanSplatProbe(const vulkan::Device& device, std::size_t points, int size);
    /// Clears and splats all points; seconds by the device's clock.
    double run();
    [[nodiscard]] std::uint64_t count() const { return count_; }

private:
    const vulkan::Device& device_;
    std::uint64_t count_;
    std::uint32_t size_;
    vulkan::Kernel kernel_;
    vulkan::Commands commands_;
    vulkan::Buffer points_, keys_;
};

/// Triangles on Vulkan: corners from a buffer, one 64-bit minimum a fragment, the nearest wins.
class VulkanRasterProbe {
public:
    struct Corner {
        float x, y, z;  // normalised device coordinates of an image of size²; z > 0
        std::uint32_t payload;
    };
    /// Three corners each.
    VulkanRasterProbe(const vulkan::Device& device, std::span<const Corner> corners, int size);
    /// Clears and draws all triangles; seconds by the device's clock.
    double run();

private:
    std::uint32_t count_, size_;
    vulkan::RasterKernel kernel_;
    vulkan::Commands commands_;
    vulkan::Buffer corners_, keys_;
};

/// Trilinear samples on Vulkan: TrilinearProbe's rays, one an invocation.
class VulkanMarchProbe {
public:
    /// samples³, pixels² (a multiple of 4); value(i, j, k).
    ///   packed  the four samples of a cell at its lower z as one word; else float32
    VulkanMarchProbe(const vulkan::Device& device, int samples, int pixels, std::uint8_t (*value)(int, int, int), bool packed);
    /// Seconds by the device's clock.
    double run();
    /// How many samples are taken.
    [[nodiscard]] std::uint64_t taken() const { return taken_; }

private:
    const vulkan::Device& device_;
    std::uint32_t count_, samples_;
    std::uint64_t taken_ = 0;
    vulkan::Kernel kernel_;
    vulkan::Commands commands_;
    vulkan::Buffer words_, rays_, sums_;
};

/// All hits of coherent primary rays with triangles: Embree with a 16-wide context filter that keeps
/// depth and ids, then a sort a ray. The camera is a pinhole at (0, 0, distance) that looks along −z.
class EmbreeProbe {
public:
    struct View {
        double distance;
        double pixel_size;  // at distance 1
        int size;
    };
    EmbreeProbe(const TriangleMesh& mesh, const View& view);
    ~EmbreeProbe();
    EmbreeProbe(const EmbreeProbe&) = delete;
    EmbreeProbe& operator=(const EmbreeProbe&) = delete;
    /// Traces size² rays, one a pixel centre, in packets of 4×4 pixels, on all threads; returns the hits.
    std::uint64_t run() const;

private:
    struct Embree;
    std::unique_ptr<Embree> embree_;
    View view_;
};

/// Random lines through the sphere around a torus (radii 1 and 0.4) and where they cross it: the quartic
/// on the line, its changes of sign in 16 steps, and three steps of safeguarded Newton in each.
class TorusLinesProbe {
public:
    explicit TorusLinesProbe(std::uint64_t lines) : lines_(lines) {}
    /// Returns how many crossings were found and stored, 16 bytes each.
    std::uint64_t run();

private:
    std::uint64_t lines_;
};

/// The same through a Barth sextic in a sphere of radius 1.65. Steps miss close pairs of roots.
class SexticLinesProbe {
public:
    explicit SexticLinesProbe(std::uint64_t lines) : lines_(lines) {}
    std::uint64_t run();

private:
    std::uint64_t lines_;
};

/// Brownian steps on a torus (radii 1 and 0.4) as brownian_walk.hpp takes them, in double: two Gaussian numbers, the
/// tangent plane, dx^(S), two corrections.
class TorusWalkProbe {
public:
    explicit TorusWalkProbe(std::uint64_t steps) : steps_(steps) {}
    /// Returns how many steps were taken.
    std::uint64_t run();

private:
    std::uint64_t steps_;
};

/// Trilinear samples of a cube of uint8, one voxel apart on the rays of an oblique view that it fills.
class TrilinearProbe {
public:
    /// samples³, pixels² (a multiple of 4); value(i, j, k).
    TrilinearProbe(int samples, int pixels, std::uint8_t (*value)(int, int, int));
    /// On all threads; returns how many samples lay inside of the cube.
    std::uint64_t run() const;

private:
    int samples_, pixels_, blocks_;
    std::vector<std::uint8_t> data_;
};

/// memcpy on all threads.
class CopyProbe {
public:
    explicit CopyProbe(std::uint64_t bytes);
    /// Returns how many bytes were copied.
    std::uint64_t run();

private:
    std::vector<unsigned char> from_, to_;
};

}  // namespace pellucid::bench
