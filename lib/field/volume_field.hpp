// A sampled volume as a function of place: trilinear, Catmull-Rom or nearest. Places count samples (index
// space).
#pragma once

#include <array>
#include <cstdint>
#include <memory>

#include "core/vec.hpp"
#include "field/scalar_field.hpp"
#include "io/volume_file.hpp"

namespace pellucid {

enum class Interpolation { trilinear, catmull_rom, nearest };

/// Catmull-Rom (E. Catmull, R. Rom, A class of local interpolating splines, 1974; tension ½): in each cell a
/// cubic along each axis through its 4³ samples, C¹ everywhere. Beyond the first and last sample of an axis
/// stands the linear continuation 2·v₀ − v₁, so that linear volumes stay linear to their border.
class VolumeField {
public:
    VolumeField(std::shared_ptr<const VoxelGrid> grid, Interpolation interpolation);

    [[nodiscard]] const VoxelGrid& grid() const { return *grid_; }
    [[nodiscard]] Interpolation interpolation() const { return interpolation_; }
    /// The hull of the samples: 0 … size − 1 along each axis.
    [[nodiscard]] Box hull() const;
    /// Cells along each axis; one on an axis of one sample.
    [[nodiscard]] std::array<int, 3> cells() const;
    /// NaN outside of the hull, and where a sample that counts is not a number. `less` is taken off the
    /// samples, so that where all of them have that value the result is exactly 0.
    [[nodiscard]] double value(const Vec3& p, double less = 0) const;
    /// Exact derivatives of the interpolant, per index: within a cell; at a face those of the cell that
    /// `cell_of` names. Nearest: zero.
    [[nodiscard]] FieldJet jet(const Vec3& p, double less = 0) const;
    /// First sample of the cell that holds p; the last cell of an axis holds its end.
    [[nodiscard]] std::array<int, 3> cell_of(const Vec3& p) const;

    using Samples = std::array<float, 64>;
    /// The samples −1 … 2 around a cell along each axis, x fastest, continued beyond the border. Axes of one
    /// sample repeat it.
    [[nodiscard]] Samples samples_around(const std::array<int, 3>& cell) const;
    /// Whether all of them are samples of the grid.
    [[nodiscard]] bool is_inside(const std::array<int, 3>& cell) const;
    [[nodiscard]] std::size_t bytes() const { return grid_->values.size() * sizeof(float); }

private:
    [[nodiscard]] bool holds(const Vec3& p) const;
    [[nodiscard]] double nearest_at(const Vec3& p, double less) const;
    [[nodiscard]] std::array<double, 8> corners_of(const std::array<int, 3>& cell, double less) const;

    std::shared_ptr<const VoxelGrid> grid_;
    Interpolation interpolation_;
};

/// Weights of the samples −1, 0, 1, 2 at t in [0, 1], and their first and second derivatives. At 0 and 1 the
/// values are exactly 0 and 1.
struct CatmullRomWeights {
    std::array<double, 4> value, slope, bend;
    explicit CatmullRomWeights(double t);
};

/// Σ of the samples around a cell, each less a number, by the weights along the three axes.
[[nodiscard]] double catmull_rom_sum(const VolumeField::Samples& samples, double less,
                                     const std::array<double, 4>& x, const std::array<double, 4>& y,
                                     const std::array<double, 4>& z);
/// Value and gradient at t in the unit cube.
[[nodiscard]] double catmull_rom_value(const VolumeField::Samples& samples, double less, const Vec3& t);
[[nodiscard]] Vec3 catmull_rom_gradient(const VolumeField::Samples& samples, double less, const Vec3& t);

}  // namespace pellucid
