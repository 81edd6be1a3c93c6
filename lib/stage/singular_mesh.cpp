#include "stage/singular_mesh.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <unordered_map>
#include <vector>

#include "core/parallel.hpp"
#include "field/safeguarded_newton.hpp"

namespace pellucid {
namespace {

/// Boxes along the longest edge of the bounds, of six tetrahedra each, to begin with.
constexpr int kBoxes = 12;
/// Edges are not made shorter than this share of the bounds, however near the eye is.
constexpr double kCoarsest = 1.0 / 192, kFinest = 1.0 / 1024;
/// Cosine between two normals in a tetrahedron from which on one sheet explains them.
constexpr double kOneSheet = 0.5;
/// A fall below zero between two ends is taken for one where it is more than this share of what they have.
constexpr double kDip = 1e-9;
/// Looked for in tetrahedra down to this share of the finest.
constexpr double kDipShare = 0.4;
constexpr int kHalvings = 24;
constexpr int kMostRounds = 60;
constexpr std::size_t kGrain = 512;

using Tetrahedron = std::array<std::uint32_t, 4>;
constexpr std::array<std::array<std::size_t, 2>, 6> kEdges{{{0, 1}, {0, 2}, {0, 3}, {1, 2}, {1, 3}, {2, 3}}};

struct Corner {
    Vec3 place;     // object
    double value;
    Vec3 gradient;  // object
    Vec3 normal;    // world, unit length or zero
};

[[nodiscard]] std::uint64_t key_of(std::uint32_t a, std::uint32_t b) {
    const auto [lo, hi] = std::minmax(a, b);
    return std::uint64_t{lo} << 32U | hi;
}

class Mesher {
public:
    Mesher(const FieldSurface& surface, const Camera& camera, const SingularMeshSettings& settings)
        : surface_(surface),
          camera_(camera),
          settings_(settings),
          inverse_transposed_(glm::transpose(surface.to_world.inverse().linear)),
          corner_(camera.pixel_size() * length(glm::max(camera.center(), Vec2(camera.width(), camera.height()) - camera.center()))),
          longest_(length(surface.to_world.linear * surface.bounds.size())) {}

    [[nodiscard]] TriangleMesh run() {
        begin();
        look(0);
        for (int round = 0; round < kMostRounds && tetrahedra_.size() < settings_.most_tetrahedra; ++round)
            if (!bisect()) break;
        return march();
    }

private:
    struct Wish {
        bool cut = false;                          // at its longest edge
        std::array<float, 6> dip{-1, -1, -1, -1, -1, -1};  // where to cut an edge because of what it hides
    };
    struct Edge {
        std::uint32_t a, b;
        double at;
    };

    [[nodiscard]] Corner corner(const Vec3& place) const {
        const FieldJet jet = surface_.field->jet(place);
        const Vec3 normal = inverse_transposed_ * jet.gradient;
        const double size = length(normal);
        return {place, jet.value, jet.gradient, size > 0 && size < kInfinity ? normal / size : Vec3(0.0)};
    }
    [[nodiscard]] double length_of(std::uint32_t a, std::uint32_t b) const {
        return length(surface_.to_world.vector(corners_[b].place - corners_[a].place));
    }
    [[nodiscard]] static bool negative(const Corner& c) { return c.value < 0; }

    /// Boxes of six tetrahedra around their diagonal, alike in all: neighbours meet.
    void begin() {
        const Vec3 size = surface_.bounds.size();
        std::array<std::uint32_t, 3> count;
        double longest = 0;
        for (int a = 0; a < 3; ++a) longest = std::max(longest, size[a] * length(surface_.to_world.linear[a]));
        for (int a = 0; a < 3; ++a)
            count[static_cast<std::size_t>(a)] = static_cast<std::uint32_t>(
                std::max(1.0, std::ceil(kBoxes * size[a] * length(surface_.to_world.linear[a]) / longest - 1e-9)));
        const auto number = [&](std::uint32_t i, std::uint32_t j, std::uint32_t k) {
            return (k * (count[1] + 1) + j) * (count[0] + 1) + i;
        };
        for (std::uint32_t k = 0; k <= count[2]; ++k)
            for (std::uint32_t j = 0; j <= count[1]; ++j)
                for (std::uint32_t i = 0; i <= count[0]; ++i) {
                    Vec3 p;
                    const std::array<std::uint32_t, 3> at{i, j, k};
                    for (int a = 0; a < 3; ++a) {
                        const auto n = static_cast<std::size_t>(a);
                        p[a] = at[n] == count[n] ? surface_.bounds.hi[a] : surface_.bounds.lo[a] + size[a] * at[n] / count[n];
                    }
                    corners_.push_back(corner(p));
                }
        constexpr std::array<std::array<std::size_t, 3>, 6> kOrders{{{0, 1, 2}, {0, 2, 1}, {1, 0, 2}, {1, 2, 0}, {2, 0, 1}, {2, 1, 0}}};
        for (std::uint32_t k = 0; k < count[2]; ++k)
            for (std::uint32_t j = 0; j < count[1]; ++j)
                for (std::uint32_t i = 0; i < count[0]; ++i)
                    for (const auto& order : kOrders) {
                        std::array<std::uint32_t, 3> at{i, j, k};
                        Tetrahedron t{number(i, j, k)};
                        for (std::size_t step = 0; step < 3; ++step) {
                            ++at[order[step]];
                            t[step + 1] = number(at[0], at[1], at[2]);
                        }
                        tetrahedra_.push_back(t);
                    }
    }

    /// What the new ones wish; those without surface are dropped.
    void look(std::size_t from) {
        wishes_.resize(tetrahedra_.size());
        std::vector<char> dead(tetrahedra_.size() - from, 0);
        parallel_for(dead.size(), kGrain, [&](std::size_t begin, std::size_t end) {
            for (std::size_t i = begin; i < end; ++i) {
                Box box;
                for (const std::uint32_t c : tetrahedra_[from + i]) box.include(corners_[c].place);
                if (surface_.field->excludes(box)) dead[i] = 1;
                else wishes_[from + i] = wish_of(tetrahedra_[from + i]);
            }
        });
        std::size_t kept = from;
        for (std::size_t i = from; i < tetrahedra_.size(); ++i)
            if (dead[i - from] == 0) {
                tetrahedra_[kept] = tetrahedra_[i];
                wishes_[kept++] = wishes_[i];
            }
        tetrahedra_.resize(kept);
        wishes_.resize(kept);
    }

    [[nodiscard]] Wish wish_of(const Tetrahedron& t) const {
        Wish wish;
        Vec3 middle(0.0);
        for (const std::uint32_t c : t) middle += 0.25 * corners_[c].place;
        double longest = 0;
        for (const auto& [a, b] : kEdges) longest = std::max(longest, length_of(t[a], t[b]));
        const Vec3 view = camera_.to_view(surface_.to_world.point(middle));
        if (view.z + longest < camera_.near()) return wish;
        // What is aside of the view counts where it would enter it: beside the eye pixels have no size.
        const double z = std::max({view.z, length(Vec2(view)) / corner_, camera_.near()});
        const double pixel = camera_.pixel_size() * (camera_.perspective() ? z : 1);
        if (longest > std::max(settings_.coarse_px * pixel, kCoarsest * longest_)) {
            wish.cut = true;
            return wish;
        }
        const double fine = std::max(settings_.fine_px * pixel, kFinest * longest_);
        if (!(longest > kDipShare * fine)) return wish;
        bool turns = false;
        for (const auto& [a, b] : kEdges) turns = turns || !(dot(corners_[t[a]].normal, corners_[t[b]].normal) > kOneSheet);
        if (!turns) return wish;
        wish.cut = longest > fine;
        for (std::size_t e = 0; e < 6; ++e) {
            const auto& [a, b] = kEdges[e];
            wish.dip[e] = static_cast<float>(dip_between(t[a], t[b]));
        }
        return wish;
    }

    /// Share of the way from the one with the smaller number at which f has the other sign than at both ends; -1 where none is
    /// found.
    [[nodiscard]] double dip_between(std::uint32_t i, std::uint32_t j) const {
        const Corner& a = corners_[std::min(i, j)];
        const Corner& b = corners_[std::max(i, j)];
        if (negative(a) != negative(b)) return -1;
        const double sign = negative(a) ? -1 : 1;
        const Vec3 along = b.place - a.place;
        if (!(sign * dot(a.gradient, along) < 0 && sign * dot(b.gradient, along) > 0)) return -1;
        const double enough = -kDip * std::min(std::abs(a.value), std::abs(b.value));
        double lo = 0, hi = 1;
        for (int step = 0; step < kHalvings; ++step) {
            const double t = 0.5 * (lo + hi);
            const FieldJet jet = surface_.field->jet(a.place + t * along);
            if (sign * jet.value < enough) return t;
            (sign * dot(jet.gradient, along) < 0 ? lo : hi) = t;
        }
        return -1;
    }

    /// One round of cuts; false where none is wished.
    [[nodiscard]] bool bisect() {
        const std::size_t count = tetrahedra_.size();
        cuts_.clear();
        std::vector<Edge> edges;
        std::vector<char> touched(corners_.size(), 0);  // ends of edges that are cut: a look before the table is asked
        const auto mark = [&](std::uint32_t a, std::uint32_t b, double at) {
            if (!cuts_.emplace(key_of(a, b), static_cast<std::uint32_t>(corners_.size() + edges.size())).second) return;
            edges.push_back({std::min(a, b), std::max(a, b), at});
            touched[a] = touched[b] = 1;
        };
        const auto is_cut = [&](const Tetrahedron& t) {
            if (touched[t[0]] + touched[t[1]] + touched[t[2]] + touched[t[3]] < 2) return false;
            return std::ranges::any_of(kEdges, [&](const auto& e) {
                return (touched[t[e[0]]] & touched[t[e[1]]]) != 0 && cuts_.contains(key_of(t[e[0]], t[e[1]]));
            });
        };
        const auto longest_edge = [&](const Tetrahedron& t) {
            std::size_t best = 0;
            for (std::size_t e = 1; e < 6; ++e)
                if (before(t, e, best)) best = e;
            return best;
        };
        for (std::size_t i = 0; i < count; ++i)
            for (std::size_t e = 0; e < 6; ++e)
                if (wishes_[i].dip[e] > 0)
                    mark(tetrahedra_[i][kEdges[e][0]], tetrahedra_[i][kEdges[e][1]], static_cast<double>(wishes_[i].dip[e]));
        for (std::size_t i = 0; i < count; ++i)
            if (wishes_[i].cut) {
                const auto& [a, b] = kEdges[longest_edge(tetrahedra_[i])];
                mark(tetrahedra_[i][a], tetrahedra_[i][b], 0.5);
            }
        if (edges.empty()) return false;
        // Who is cut at another edge is cut at its longest, too, or it would become a splinter.
        for (std::size_t before_pass = 0; before_pass != edges.size();) {
            before_pass = edges.size();
            for (std::size_t i = 0; i < count; ++i) {
                const Tetrahedron& t = tetrahedra_[i];
                if (!is_cut(t)) continue;
                const auto& [a, b] = kEdges[longest_edge(t)];
                mark(t[a], t[b], 0.5);
            }
        }
        const std::size_t first = corners_.size();
        corners_.resize(first + edges.size());
        parallel_for(edges.size(), kGrain, [&](std::size_t begin, std::size_t end) {
            for (std::size_t i = begin; i < end; ++i) {
                const Vec3& a = corners_[edges[i].a].place;
                corners_[first + i] = corner(a + edges[i].at * (corners_[edges[i].b].place - a));
            }
        });
        std::vector<Tetrahedron> whole, parts;
        std::vector<Wish> wishes;
        for (std::size_t i = 0; i < count; ++i) {
            if (is_cut(tetrahedra_[i])) {
                divide(tetrahedra_[i], parts);
            } else {
                whole.push_back(tetrahedra_[i]);
                wishes.push_back(wishes_[i]);
            }
        }
        const std::size_t unchanged = whole.size();
        tetrahedra_ = std::move(whole);
        wishes_ = std::move(wishes);
        tetrahedra_.insert(tetrahedra_.end(), parts.begin(), parts.end());
        // The old ones have said what they wish.
        look(unchanged);
        return true;
    }

    /// Longer edges come first; of equal ones, which all must agree on, those of smaller numbers.
    [[nodiscard]] bool before(const Tetrahedron& t, std::size_t e, std::size_t other) const {
        const auto& [a, b] = kEdges[e];
        const auto& [c, d] = kEdges[other];
        const std::uint64_t key = key_of(t[a], t[b]), other_key = key_of(t[c], t[d]);
        const auto size = [&](std::uint64_t k) {
            return length_of(static_cast<std::uint32_t>(k >> 32U), static_cast<std::uint32_t>(k));
        };
        const double one = size(key), two = size(other_key);
        return one != two ? one > two : key < other_key;
    }

    void divide(const Tetrahedron& t, std::vector<Tetrahedron>& out) const {
        std::size_t best = 6;
        std::uint32_t middle = 0;
        for (std::size_t e = 0; e < 6; ++e) {
            const auto found = cuts_.find(key_of(t[kEdges[e][0]], t[kEdges[e][1]]));
            if (found == cuts_.end() || (best < 6 && !before(t, e, best))) continue;
            best = e;
            middle = found->second;
        }
        if (best == 6) {
            out.push_back(t);
            return;
        }
        for (const std::size_t end : kEdges[best]) {
            Tetrahedron part = t;
            part[end] = middle;
            divide(part, out);
        }
    }

    [[nodiscard]] TriangleMesh march() const {
        TriangleMesh mesh;
        std::vector<Edge> edges;
        std::unordered_map<std::uint64_t, std::uint32_t> vertex;
        const auto cross_edge = [&](std::uint32_t a, std::uint32_t b) {
            const auto [found, added] = vertex.emplace(key_of(a, b), static_cast<std::uint32_t>(edges.size()));
            if (added) edges.push_back({std::min(a, b), std::max(a, b), 0});
            return found->second;
        };
        for (const Tetrahedron& t : tetrahedra_) {
            std::array<std::uint32_t, 4> below{}, above{};
            std::size_t low = 0, high = 0;
            for (const std::uint32_t c : t) (negative(corners_[c]) ? below[low++] : above[high++]) = c;
            if (low == 0 || high == 0) continue;
            if (low == 2) {
                const std::array<std::uint32_t, 4> q{cross_edge(below[0], above[0]), cross_edge(below[0], above[1]),
                                                     cross_edge(below[1], above[1]), cross_edge(below[1], above[0])};
                mesh.triangles.push_back({q[0], q[1], q[2]});
                mesh.triangles.push_back({q[0], q[2], q[3]});
            } else {
                const std::uint32_t alone = low == 1 ? below[0] : above[0];
                const auto& others = low == 1 ? above : below;
                mesh.triangles.push_back({cross_edge(alone, others[0]), cross_edge(alone, others[1]), cross_edge(alone, others[2])});
            }
        }
        mesh.positions.resize(edges.size());
        mesh.normals.resize(edges.size());
        std::vector<char> good(edges.size());
        parallel_for(edges.size(), kGrain, [&](std::size_t begin, std::size_t end) {
            for (std::size_t i = begin; i < end; ++i) {
                const Corner& a = corners_[edges[i].a];
                const Corner& b = corners_[edges[i].b];
                const Vec3 along = b.place - a.place;
                const double t = safeguarded_newton(0, 1, 0.5, negative(a), [&](double at) {
                    const FieldJet jet = surface_.field->jet(a.place + at * along);
                    return std::pair(std::isnan(jet.value) ? kInfinity : jet.value, dot(jet.gradient, along));
                });
                const Corner root = corner(a.place + t * along);
                // At a pole f changes its sign and is nowhere near zero.
                good[i] = std::abs(root.value) <= 0.1 * std::max(std::abs(a.value), std::abs(b.value)) ? 1 : 0;
                mesh.positions[i] = surface_.to_world.point(root.place);
                mesh.normals[i] = root.normal;
            }
        });
        std::erase_if(mesh.triangles, [&](const auto& t) { return (good[t[0]] & good[t[1]] & good[t[2]]) == 0; });
        // Counter-clockwise seen from where f is positive.
        for (auto& t : mesh.triangles) {
            const auto& p = mesh.positions;
            if (dot(cross(p[t[1]] - p[t[0]], p[t[2]] - p[t[0]]), mesh.normals[t[0]] + mesh.normals[t[1]] + mesh.normals[t[2]]) < 0)
                std::swap(t[1], t[2]);
        }
        return mesh;
    }

    const FieldSurface& surface_;
    const Camera& camera_;
    SingularMeshSettings settings_;
    Mat3 inverse_transposed_;
    double corner_;   // tangent of the angle between the axis and the image's farthest corner (perspective)
    double longest_;  // of the bounds, world
    std::vector<Corner> corners_;
    std::vector<Tetrahedron> tetrahedra_;
    std::vector<Wish> wishes_;
    std::unordered_map<std::uint64_t, std::uint32_t> cuts_;  // edges of this round and their new corners
};

}  // namespace

TriangleMesh singular_mesh(const FieldSurface& surface, const Camera& camera, const SingularMeshSettings& settings) {
    return surface.bounds.empty() ? TriangleMesh{} : Mesher(surface, camera, settings).run();
}

}  // namespace pellucid
