// A volume that is read and placed: what truth and samplers ask of it.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <vector>

#include "field/volume_field.hpp"
#include "scene/scene.hpp"
#include "scene/transfer.hpp"

namespace pellucid {

/// Least and largest value; lo > hi: none.
struct ValueRange {
    double lo = kInfinity;
    double hi = -kInfinity;
};

/// A trilinear function on the unit cube by differences: where all corners are equal it is exactly their value.
struct TrilinearDifferences {
    TrilinearDifferences() = default;
    /// x fastest.
    explicit TrilinearDifferences(const std::array<float, 8>& corner);
    [[nodiscard]] double value(const Vec3& t) const {
        return one + t.x * (x + t.y * (xy + t.z * xyz) + t.z * xz) + t.y * (y + t.z * yz) + t.z * z;
    }
    [[nodiscard]] Vec3 gradient(const Vec3& t) const {
        return {x + t.y * (xy + t.z * xyz) + t.z * xz, y + t.x * (xy + t.z * xyz) + t.z * yz,
                z + t.x * (xz + t.y * xyz) + t.y * yz};
    }

    double one = 0, x = 0, y = 0, z = 0, xy = 0, xz = 0, yz = 0, xyz = 0;
};

/// Cells are those of the interpolant: between samples, or (nearest) around each.
class VolumeObject {
public:
    /// Reads or samples it. Throws Error(input) naming the volume.
    explicit VolumeObject(const Volume& volume);

    [[nodiscard]] const Volume& settings() const { return settings_; }
    [[nodiscard]] const VolumeField& field() const { return field_; }
    [[nodiscard]] const TransferFunction& transfer() const { return transfer_; }
    [[nodiscard]] double opacity_step() const { return opacity_step_; }
    [[nodiscard]] const Affine& to_world() const { return to_world_; }  // of index space
    [[nodiscard]] const Affine& to_index() const { return to_index_; }
    /// Of the hull, world; empty where there is nothing to draw.
    [[nodiscard]] const Box& bounds() const { return bounds_; }

    /// False where a clip plane cuts the point away.
    [[nodiscard]] bool keeps(const Vec3& world) const;
    /// NaN outside of the hull and where a sample that counts is not a number.
    [[nodiscard]] double value(const Vec3& index) const;
    /// Of the interpolant, per index; 0 with `nearest`.
    [[nodiscard]] Vec3 gradient(const Vec3& index) const;
    /// −ln(1 − opacity)/opacity_step, in 1/scene unit; infinite at opacity 1.
    [[nodiscard]] double extinction_of(double opacity) const;

    [[nodiscard]] std::array<int, 3> cells() const;
    /// What is added to an index to count cells: ½ with `nearest`, else 0.
    [[nodiscard]] double cell_shift() const { return settings_.interpolation == Interpolation::nearest ? 0.5 : 0; }
    /// Corner values of a cell (trilinear).
    [[nodiscard]] std::array<float, 8> corners(const std::array<int, 3>& cell) const;
    /// Holds every value of the interpolant in the cells from `first` up to, not including, `end`.
    [[nodiscard]] ValueRange range(const std::array<int, 3>& first, const std::array<int, 3>& end) const;

    /// Cells in blocks of kBlock³, x fastest.
    static constexpr int kBlock = 8;
    [[nodiscard]] const std::array<int, 3>& blocks() const { return blocks_; }
    [[nodiscard]] std::size_t block_of(const std::array<int, 3>& cell) const {
        return block_index({cell[0] / kBlock, cell[1] / kBlock, cell[2] / kBlock});
    }
    [[nodiscard]] std::size_t block_index(const std::array<int, 3>& block) const {
        return static_cast<std::size_t>(block[0]) +
               static_cast<std::size_t>(blocks_[0]) *
                   (static_cast<std::size_t>(block[1]) + static_cast<std::size_t>(blocks_[1]) * static_cast<std::size_t>(block[2]));
    }
    /// Largest opacity in a block of cells.
    [[nodiscard]] double block_opacity(std::size_t block) const { return static_cast<double>(block_opacity_[block]); }
    /// Largest of all that occurs.
    [[nodiscard]] double most_opacity() const;
    [[nodiscard]] std::size_t bytes() const { return field_.bytes() + block_opacity_.size() * sizeof(float); }

private:
    void find_blocks();

    Volume settings_;
    VolumeField field_;
    TransferFunction transfer_;
    Affine to_world_, to_index_;
    double opacity_step_ = 1;
    Box bounds_;
    std::array<int, 3> blocks_{};
    std::vector<float> block_opacity_;  // rounded up
};

/// The samples of a file or a formula; what is infinite becomes NaN. Throws Error(input).
[[nodiscard]] VoxelGrid read_or_sample(const std::variant<std::filesystem::path, ExpressionVolume>& source);

}  // namespace pellucid
