// A volume less an isovalue, as a field whose zeros are the isosurface. Index space.
#pragma once

#include <memory>
#include <vector>

#include "field/scalar_field.hpp"
#include "field/volume_field.hpp"

namespace pellucid {

/// Trilinear or Catmull-Rom.
class IsoField final : public ScalarField {
public:
    IsoField(std::shared_ptr<const VolumeField> volume, double isovalue);

    [[nodiscard]] const VolumeField& volume() const { return *volume_; }
    [[nodiscard]] double isovalue() const { return isovalue_; }
    /// NaN outside of the hull, and where a sample that counts is not a number.
    [[nodiscard]] double value(const Vec3& x) const override { return volume_->value(x, isovalue_); }
    [[nodiscard]] FieldJet jet(const Vec3& x) const override { return volume_->jet(x, isovalue_); }
    [[nodiscard]] bool excludes(const Box& box) const override;

    /// Cells come in bricks, of which is known whether they may hold a zero.
    static constexpr int kBrick = 8;
    [[nodiscard]] std::size_t brick_count() const { return may_hold_.size(); }
    [[nodiscard]] bool brick_may_hold(std::size_t brick) const { return may_hold_[brick] != 0; }
    /// First and one past the last cell of a brick along each axis.
    struct CellRange {
        std::array<int, 3> first, last;
    };
    [[nodiscard]] CellRange cells_of_brick(std::size_t brick) const;
    [[nodiscard]] std::size_t bytes() const { return may_hold_.capacity(); }

private:
    [[nodiscard]] bool may_hold(const CellRange& cells) const;
    [[nodiscard]] bool cell_excludes(const std::array<int, 3>& cell, const Box& box) const;

    std::shared_ptr<const VolumeField> volume_;
    double isovalue_;
    std::array<int, 3> bricks_{};
    std::vector<std::uint8_t> may_hold_;
};

}  // namespace pellucid
