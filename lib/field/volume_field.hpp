// A sampled volume as a function of place: trilinear, Catmull-Rom or nearest. Places count samples (index space).
#pragma once

#include <array>
#include <cstdint>
#include <memory>

#include "core/vec.hpp"
#include "field/scalar_field.hpp"
#include "io/volume_file.hpp"

namespace pellucid {

enum class Interpolation { trilinear, catmull_rom, nearest };

/// Catmull-Rom (E. Catmull, R. Rom, A class of local interpolating splines, 1974; tension ½): in each cell a cubic along
/// each axis through its 4³ samples, C¹ everywhere. Beyond the first and last sample of an axis stands the linear
/// continuation 2·v₀ − v₁, so that linear volumes stay linear to their border.
class VolumeField {
public:
    VolumeField(std::shared_ptr<const VoxelGrid> grid, Interpolation interpolation);

    [[nodiscard]] const VoxelGrid& grid() const { return *grid_; }
    [[nodiscard]] Interpolation interpolation() const { return interpolation_; }
    /// The hull of the samples: 0 … size − 1 along each axis.
    [[nodiscard]] Box hull() const;
    /// NaN outside of the hull, and where a sample that counts is not a number.
    [[nodiscard]] double value(const Vec3& p) const;
    /// Exact derivatives of the interpolant, per index: within a cell; at a face those of the cell that `cell_of` names.
    /// Nearest: zero.
    [[nodiscard]] FieldJet jet(const Vec3& p) const;
    /// First sample of the cell that holds p; the last cell of an axis holds its end.
    [[nodiscard]] std::array<int, 3> cell_of(const Vec3& p) const;

    using Samples = std::array<float, 64>;
    /// The samples −1 … 2 around a cell along each axis, x fastest, continued beyond the border. Axes of one sample repeat it.
    [[nodiscard]] Samples samples_around(const std::array<int, 3>& cell) const;
    [[nodiscard]] std::size_t bytes() const { return grid_->values.size() * sizeof(float); }

private:
    std::shared_ptr<const VoxelGrid> grid_;
    Interpolation interpolation_;
};

/// Weights of the samples −1, 0, 1, 2 at t in [0, 1], and their first and second derivatives.
struct CatmullRomWeights {
    std::array<double, 4> value, slope, bend;
    explicit CatmullRomWeights(double t);
};

}  // namespace pellucid
