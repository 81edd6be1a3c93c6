// Emission and absorption along rays through the volumes of a scene: N. Max, Optical models for direct volume
// rendering, IEEE TVCG 1 (1995). Extinction σ = Σ σ_i, emission Σ σ_i c_i of all volumes at a place.
//
// A ray is walked cell by cell of every volume, and pieces end where a cell, a hull, a clip plane or a piece
// of a transfer function ends. On a piece Gauss' three points (degree 5) do where a bound of their error says so,
// which is nearly everywhere in thin media. Elsewhere Kronrod's five points (degree 7) are compared with Gauss' two
// (degree 3) among them, and the piece is halved until they agree.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "scene/prepared_scene.hpp"

namespace pellucid {

/// A part of a ray through volumes, in which colour mixes by extinction and its own transmittance.
struct VolumeLayer {
    double t;              // depth along the view axis, of its middle
    double optical_depth;  // infinite where it blocks
    Vec3 color;            // straight
    double half_length = 0;  // of its depth; the optical depth is evenly in it
};

struct VolumeRaySettings {
    /// By how much the two rules may differ in opacity and colour (of a brightest colour of 1) over the whole
    /// ray. The better one, which counts, has twice the order and errs by less.
    double tolerance = 1e-4;
    /// Opacities of transfer functions are taken as at most this.
    double most_opacity = 1;
    /// For layers that are pooled with those of other rays, as optical depth by depth: colour is by extinction,
    /// whatever a layer's own transmittance, and `clear` is of no account.
    bool pooled = false;
};

/// One ray at a time; one a thread.
class VolumeRay {
public:
    /// The scene must outlive it.
    VolumeRay(const PreparedScene& scene, const VolumeRaySettings& settings);

    [[nodiscard]] bool has_volumes() const { return !walks_.empty(); }
    /// Begins a ray between near and far.
    ///   share  of it in the pool, if pooled: behind its optical depth alone nothing is seen any more
    void start(const Ray& ray, double share = 1);
    /// Appends the layers from the last place up to depth t, with a transmittance `clear` in front of them.
    /// Fewer where nothing is seen any more (below `least_clear`).
    void advance(double t, double clear, double least_clear, std::vector<VolumeLayer>& out);
    /// Bit i mod 64: volume i was met, in part of it that is not empty.
    [[nodiscard]] std::uint64_t met() const { return met_; }
    /// Rays that needed more halvings than this: their last pieces are as they are.
    [[nodiscard]] std::uint64_t cut_short() const { return cut_short_; }
    static constexpr int kMostHalvings = 1 << 12;

private:
    /// A polynomial on [−1, 1], lowest first.
    struct Along {
        int degree = 0;
        std::array<double, 10> c{};
        [[nodiscard]] double operator()(double u) const {
            double sum = c[static_cast<std::size_t>(degree)];
            for (int k = degree; k-- > 0;) sum = sum * u + c[static_cast<std::size_t>(k)];
            return sum;
        }
        [[nodiscard]] double slope(double u) const {
            double sum = 0;
            for (int k = degree; k > 0; --k) sum = sum * u + k * c[static_cast<std::size_t>(k)];
            return sum;
        }
    };
    /// Where one volume is being walked.
    struct Walk {
        const VolumeObject* volume;
        std::uint32_t index;
        bool lit;
        // Of the ray: in cells at depth t: from + t·along.
        Vec3 from, along;
        double t_in, t_out;
        std::array<int, 3> cells, cell, step;
        std::array<double, 3> t_next;  // depth of the next face across each axis
        bool inside = false;
        // The cell's part of the ray, and value along it.
        double cell_begin, cell_end;
        double middle, per_half;  // u = (t − middle)·per_half in [−1, 1]
        std::size_t known_piece;  // of the transfer function, where the last values were
        VolumeField::Samples around;  // Catmull-Rom
        Along value;
        TrilinearDifferences cell_values;  // trilinear
        // Pieces of the cell, rising; the current one is the last that ends behind `piece_begin`.
        std::vector<double> ends;
        std::size_t piece;
        bool empty;                               // the current piece is
        const TransferFunction::Piece* transfer;  // null: look it up for every value
    };
    struct Sample {
        double extinction = 0;
        Vec3 emission{0.0};  // extinction · colour; where extinction is infinite the colour
    };

    /// A piece of the transfer function that holds both.
    [[nodiscard]] static bool one_piece(Walk& walk, double least, double most);
    void enter(Walk& walk, double t) const;
    bool next_cell(Walk& walk) const;
    void open_cell(Walk& walk) const;
    void open_piece(Walk& walk) const;
    void next_piece(Walk& walk) const;
    void skip_block(Walk& walk) const;
    [[nodiscard]] Vec3 lit_color(const Walk& walk, double t, const Vec3& color) const;
    [[nodiscard]] Sample at(double t) const;
    [[nodiscard]] bool integrate_smooth(const Walk& walk, double a, double b, std::vector<VolumeLayer>& out);
    void integrate(double a, double b, int depth, std::vector<VolumeLayer>& out);
    void put(double a, double b, double optical_depth, const Vec3& color, std::vector<VolumeLayer>& out);

    const PreparedScene* scene_;
    VolumeRaySettings settings_;
    std::vector<Walk> walks_;
    std::vector<Walk*> here_;  // those that are not empty on the current piece
    Ray ray_{};
    double t_ = 0;      // walked so far
    double reach_ = 0;  // t_out − t_in, summed over the volumes
    double clear_ = 1;
    double share_ = 1;
    std::size_t merge_from_ = 0;  // layers from here on may be merged
    int halvings_left_ = 0;
    std::uint64_t cut_short_ = 0;
    double least_clear_ = 0;
    double unit_ = 1;  // brightest colour
    std::uint64_t met_ = 0;
};

}  // namespace pellucid
