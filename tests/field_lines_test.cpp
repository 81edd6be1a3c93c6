// Lines along one axis of a formula's cells: scalar, SIMD and every instruction set agree; particles lie on
// the surface.
#include "sample/field_lines.hpp"

#include "field/field_cells.hpp"
#include "field_scenes.hpp"
#include "sample/line_sampler.hpp"
#include "scene_testing.hpp"
#include "simd_targets.hpp"

namespace pellucid {
namespace {

using namespace testing_scenes;

struct View {
    const char* name;
    std::string toml;
};

std::vector<View> views(const Box& bounds) {
    const Vec3 c = bounds.center();
    const double size = length(bounds.size());
    const auto at = [&](const Vec3& p) {
        const Vec3 x = c + size * p;
        return fmt::format("[{}, {}, {}]", x.x, x.y, x.z);
    };
    const std::string image = "image.resolution = [60, 50]\n[camera]\n";
    return {{"orthographic",
             fmt::format("{}projection = \"orthographic\"\nposition = {}\ntarget = {}\nview_height = {}\n",
                         image, at({0.8, 1.2, 2}), at({0, 0, 0}), size)},
            {"perspective", fmt::format("{}position = {}\ntarget = {}\nfov_degrees = 50\n", image,
                                        at({0.4, 0.6, 0.9}), at({0, 0, 0}))},
            {"from inside", fmt::format("{}position = {}\ntarget = {}\nfov_degrees = 80\n", image,
                                        at({0.05, 0.02, 0.1}), at({0.5, 0.3, 0.1}))}};
}

std::string surface(const FieldCase& c, const char* law) {
    const Box& b = c.bounds;
    return fmt::format(
        "[[surface]]\nexpression = \"{}\"\nbounds = [[{:.17g}, {:.17g}, {:.17g}], [{:.17g}, {:.17g}, "
        "{:.17g}]]\n"
        "opacity_law = \"{}\"\n",
        c.text, b.lo.x, b.lo.y, b.lo.z, b.hi.x, b.hi.y, b.hi.z, law);
}

TEST(FieldLines, BatchesEqualSingleTrialsOnEveryInstructionSet) {
    std::uint64_t compared = 0;
    for (std::size_t n = 0; n < 2 * field_cases().size(); ++n) {
        // Every formula twice: both laws, two of three views.
        const FieldCase& c = field_cases()[n / 2];
        const View view = views(c.bounds)[n % 3];
        const char* law = n % 2 == 0 ? "constant" : "oblique";
        const std::string what = fmt::format("{}, {}, {}", c.name, view.name, law);
        const PreparedScene scene = prepare(scene_from(view.toml + surface(c, law)));
        const LineSampler sampler(scene.objects[0], scene.camera, 3);
        const std::size_t step = std::max<std::size_t>(1, sampler.block_count() / 6);
        for (std::size_t block = 0; block < sampler.block_count(); block += step) {
            const Seed seed{block + 17};
            std::vector<LineSampler::Point> single;
            for (std::uint32_t i = 0; i < 401; ++i)
                if (const auto point = sampler.trial_in_block(block, seed, 5, i)) single.push_back(*point);
            for (const std::int64_t target : simd_targets()) {
                const ChosenTarget chosen(target);
                std::vector<LineSampler::Point> batch;
                sampler.trials_in_block(block, seed, 5, 0, 13, batch);  // any split gives the same
                sampler.trials_in_block(block, seed, 5, 13, 388, batch);
                ASSERT_EQ(single.size(), batch.size()) << what << hwy::TargetName(target);
                for (std::size_t i = 0; i < single.size(); ++i)
                    ASSERT_EQ(0, std::memcmp(&single[i], &batch[i], sizeof single[i]))
                        << what << hwy::TargetName(target) << " point " << i;
            }
            compared += single.size();
        }
    }
    EXPECT_GT(compared, 5000U);
    EXPECT_GT(simd_targets().size(), 1U);
}

/// Boxes that no cell would be: f bends so much, or so little, that Newton's steps do not serve; roots in the
/// ends.
struct Hard {
    std::string text;
    Box box;
    int axis;
};

std::vector<Hard> hard() {
    std::vector<Hard> all;
    for (int axis = 0; axis < 3; ++axis) {
        const char a = "xyz"[axis];
        const char b = "xyz"[(axis + 1) % 3];
        const auto put = [&](const char* form, const Box& box) {
            std::string text;
            for (const char* p = form; *p != 0; ++p) text += *p == 'a' ? a : *p == 'b' ? b : *p;
            all.push_back({text, box, axis});
        };
        put("a^3+1e-9*a-1e-4*b", cube(1));
        put("a^9+1e-3*b", cube(1));
        put("2^(60*a)-1e4*b^2-1", cube(1));
        put("a/(1+1e6*a^2)^0.5-0.9*b", cube(1));
        put("1e-250*a-1e-251*b", cube(1));
        put("1e250*a^3-1e249*b", cube(1));
        put("a-0.3", {Vec3(-0.1), Vec3(0.3)});
        put("a-0.3", {Vec3(0.3), Vec3(0.7)});
        put("a^3-0.001", {Vec3(-0.1), Vec3(0.1)});
        put("a^2-0.01", {Vec3(0.1), Vec3(0.7)});
        put("(a-0.3)^2*(1+b^2)", {Vec3(-0.1), Vec3(0.3)});
        put("a+a^2*b-b", cube(0.3));
        put("(a^2+1)*a*7.1-b*0.1", {Vec3(-0.7, -0.9, -0.8), Vec3(0.1, 1.3, 0.9)});
    }
    return all;
}

TEST(FieldLines, HardBoxesGiveTheSamePointsOnEveryInstructionSet) {
    std::mt19937_64 random(1);
    std::uniform_real_distribution<double> unit(1e-6, 1);
    std::uint64_t compared = 0;
    for (const Hard& h : hard())
        for (const View& view : views(cube(1)))
            for (const bool constant : {false, true}) {
                const PreparedScene scene =
                    prepare(scene_from(view.toml + "[[surface]]\nimplicit = \"sphere\"\n"));
                const LineView lines(scene.camera, Affine(), constant);
                const FieldPrograms programs{Expression(h.text)};
                std::vector<FieldPiece> pieces(1);
                for (std::size_t k = 0; k < 3; ++k) {
                    pieces[0].lo[k] = h.box.lo[static_cast<int>(k)];
                    pieces[0].hi[k] = h.box.hi[static_cast<int>(k)];
                }
                pieces[0].reach = 1e-3;  // nearly all are kept
                pieces[0].bound = 1;
                const FieldBlock block{pieces.data(), &programs, nullptr, nullptr, h.axis};
                static LineWords words;
                for (std::size_t i = 0; i < kChunkRoom; ++i) {
                    words.u[i] = i % 16 == 0 ? 0.5 : unit(random);
                    words.v[i] = unit(random);
                    words.chance[i] = unit(random);
                    words.piece[i] = 0;
                    words.choice[i] = 0;
                }
                constexpr std::uint32_t kCount = 251;
                std::vector<LinePoint> single;
                std::vector<std::uint64_t> numbers;
                for (std::uint32_t i = 0; i < kCount; ++i) {
                    LinePoint point;
                    if (!cross_field(lines, block, 0, words.u[i], words.v[i], words.chance[i], point))
                        continue;
                    single.push_back(point);
                    numbers.push_back(i);
                    // In the box, but for a small step: how near to the root depends on how f bends, which in
                    // cells is little.
                    const double hair = kSmallStep * (h.box.hi[h.axis] - h.box.lo[h.axis]);
                    const double root = point.place[static_cast<std::size_t>(h.axis)];
                    ASSERT_GE(root, h.box.lo[h.axis] - hair) << h.text;
                    ASSERT_LE(root, h.box.hi[h.axis] + hair) << h.text;
                }
                for (const std::int64_t target : simd_targets()) {
                    const ChosenTarget chosen(target);
                    static PointChunk chunk;
                    cross_fields(lines, block, words, kCount, chunk);
                    ASSERT_EQ(chunk.count, single.size()) << h.text << ' ' << hwy::TargetName(target);
                    for (std::size_t i = 0; i < single.size(); ++i) {
                        ASSERT_EQ(chunk.line[i], numbers[i]) << h.text;
                        for (std::size_t k = 0; k < 3; ++k) {
                            ASSERT_EQ(chunk.place[k][i], single[i].place[k])
                                << h.text << ' ' << hwy::TargetName(target);
                            ASSERT_EQ(chunk.view[k][i], single[i].view[k]) << h.text;
                            ASSERT_EQ(chunk.normal[k][i], single[i].normal[k]) << h.text;
                        }
                    }
                }
                compared += single.size();
            }
    EXPECT_GT(compared, 3000U);
}

TEST(FieldLines, PointsAreOnTheSurfaceInViewWithItsNormal) {
    for (const FieldCase& c : field_cases())
        for (const View& view : {views(c.bounds)[1]}) {
            const PreparedScene scene = prepare(scene_from(view.toml + surface(c, "constant")));
            const Camera& camera = scene.camera;
            const LineSampler sampler(scene.objects[0], camera, 0);
            const Expression f(c.text);
            const double size = length(c.bounds.size());
            const bool vanishing = std::string(c.name) == "sphere touched" || std::string(c.name) == "cubed";
            for (std::uint64_t i = 0; i < 3000 && sampler.virtual_pixels() > 0; ++i) {
                const auto p = sampler.trial({3}, 0, i);
                if (!p) continue;
                const Vec2 pixel = camera.project(p->view);
                ASSERT_TRUE(pixel.x > -1e-9 && pixel.x < camera.width() + 1e-9 && pixel.y > -1e-9 &&
                            pixel.y < camera.height() + 1e-9);
                ASSERT_GE(p->view.z, camera.near() * (1 - 1e-12));
                const Vec3 x = camera.to_world(p->view);
                for (int axis = 0; axis < 3; ++axis) {
                    ASSERT_GE(x[axis], c.bounds.lo[axis] - 3e-9 * size);
                    ASSERT_LE(x[axis], c.bounds.hi[axis] + 3e-9 * size);
                }
                const Vec3 g = f.gradient_at(x);
                const double rounding = 1e-13 * (1 + length(x));
                if (vanishing) continue;
                ASSERT_LE(std::abs(f.at(x)), length(g) * 1e-10 * size + rounding) << c.name;
                const Vec3 normal = normalize(camera.world_vector(p->view_normal));
                // Where f itself bends sharply on the way the last step went, its gradient does, too: kinks.
                if (length(g) > 0 && !f.has_kinks()) {
                    ASSERT_GT(std::abs(dot(normal, normalize(g))), 1 - 1e-5)
                        << c.name << ' ' << x.x << ' ' << x.y << ' ' << x.z;
                }
            }
        }
}

}  // namespace
}  // namespace pellucid
