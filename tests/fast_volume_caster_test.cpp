// The fast volume stage beside the plain one, on every instruction set.
#include <random>

#include "cpu/fast_volume_caster.hpp"
#include "scene_testing.hpp"
#include "simd_targets.hpp"

namespace pellucid {
namespace {

using namespace testing_scenes;
using twin::Slab;

constexpr const char* kTransfers[] = {
    // Smooth; with jumps, opacity 1 and emptiness; of more pieces than any vector has lanes (made below).
    "[[0.1, 1, 0, 0, 0], [0.4, 0, 1, 0, 0.2], [0.6, 0, 0, 1, 0.05], [0.9, 1, 1, 1, 0.6]]",
    "[[0.1, 1, 0, 0, 0], [0.4, 0, 1, 0, 0.2], [0.4, 0, 1, 0, 0], [0.7, 0, 0, 1, 0], [0.7, 1, 1, 0, 0.8], "
    "[0.72, 1, 1, 0, 1], [0.72, 0, 0, 0, 0]]",
    "many"};

std::string transfer_of(const std::string& name, double scale, double offset) {
    if (name == "many") {
        std::string text = "[";
        for (int i = 0; i < 40; ++i)
            text += fmt::format("[{}, {}, 0.5, {}, {}], ", offset + scale * i / 40.0, i % 2, 1 - i % 2,
                                i < 10 ? 0.0 : 0.004 * (i % 7) * i);
        return text + "]";
    }
    std::string text = "[";
    // Values are the first of every five numbers.
    std::string rest = name;
    std::size_t at = 0;
    while ((at = rest.find('[', at + 1)) != std::string::npos) {
        std::array<double, 5> v{};
        std::sscanf(rest.c_str() + at, "[%lf, %lf, %lf, %lf, %lf]", &v[0], &v[1], &v[2], &v[3], &v[4]);
        text += fmt::format("[{}, {}, {}, {}, {}], ", offset + scale * v[0], v[1], v[2], v[3], v[4]);
    }
    return text + "]";
}

enum class Samples { bytes, words, floats, holes };

PreparedScene scene_of(const fs::path& folder, Samples samples, const std::string& transfer,
                       const std::string& shading, int volumes = 1, const char* interpolation = "trilinear") {
    std::mt19937_64 random(5);
    std::uniform_real_distribution<double> unit(0, 1);
    const double scale = samples == Samples::bytes ? 255 : samples == Samples::words ? 6000 : 0.37;
    const double offset = samples == Samples::words ? -3000 : 0;
    std::vector<float> values = sampled({43, 38, 27}, [&](const Vec3& p) {
        const double v = p.x > 28 ? 0.05
                                  : 0.5 + 0.4 * std::sin(0.5 * p.x) * std::cos(0.4 * p.y + 0.3 * p.z) +
                                        0.05 * unit(random);
        const double stored = offset + scale * v;
        return samples == Samples::bytes || samples == Samples::words ? std::round(stored) : stored;
    });
    if (samples == Samples::holes)
        for (std::size_t i = 0; i < values.size(); ++i)
            if (i % 43 < 10 && i / 43 % 38 > 14) values[i] = std::numeric_limits<float>::quiet_NaN();
    put_volume(folder / "v.nrrd", {43, 38, 27}, values, {0.05, 0.06, 0.08});
    std::string toml =
        "image.resolution = [22, 19]\n[camera]\nposition = [3, 2.5, 4]\ntarget = [0.2, 0.1, "
        "0.2]\nfov_degrees = 28\n"
        "[[light]]\nheadlight = true\n[[light]]\ndirection = [1, 2, 0]\nintensity = 0.5\n";
    const char* moves[] = {"", "translate = [0.3, 0.2, -0.3]\n", "rotate_degrees = [30, 10, 5]\n"};
    for (int i = 0; i < volumes; ++i)
        toml += fmt::format(
            "[[volume]]\nfile = \"v.nrrd\"\nopacity_step = 0.2\ninterpolation = \"{}\"\ntransfer = "
            "{}\nshading = {}\n{}",
            interpolation, transfer_of(transfer, scale, offset), shading,
            i == 0 ? "matrix = [0.9,0.2,0,-0.8, -0.3,1,0.1,-0.9, 0,0.2,-1,0.9, 0,0,0,1]\nclip = [{ normal = "
                     "[1, 0.2, 0], offset = 0.9 }]\n"
                   : moves[i]);
    return prepare(scene_from(toml, folder));
}

struct Pixel {
    Vec3 color{0.0};
    double clear = 1;
};
Pixel composite(const std::vector<Slab>& slabs) {
    Pixel sum;
    for (const Slab& s : slabs) {
        sum.color +=
            sum.clear * Vec3(static_cast<double>(s.r), static_cast<double>(s.g), static_cast<double>(s.b));
        sum.clear *= 1 - static_cast<double>(s.a);
    }
    return sum;
}
constexpr const char* kFlat = "\"flat\"";
constexpr const char* kLit = "{ ambient = 0.3, diffuse = 0.7, specular = 0.4 }";

class FastCaster : public testing::TestWithParam<std::tuple<Samples, const char*, const char*>> {};

TEST_P(FastCaster, SlabsAreThoseOfThePlainVersion) {
    const auto& [samples, transfer, shading] = GetParam();
    const PreparedScene scene = scene_of(test_folder(), samples, transfer, shading);
    const double pitch = voxel_pitch(scene.volumes[0].to_world());
    const bool flat = std::string(shading) == kFlat;
    for (const double step : {0.7, 3.0}) {
        const double bound = step < 1 ? 2e-4 : 1e-3;
        const VolumeCaster plain(scene, scene.volumes[0], {.step = step * pitch});
        std::vector<std::vector<Slab>> expected;
        for (int y = 0; y < 19; ++y)
            for (int x = 0; x < 22; ++x) {
                SlabList list;
                plain.cast(scene.camera.ray(x + 0.5, y + 0.5), list);
                expected.push_back(list.slabs);
            }
        for (const std::int64_t target : simd_targets()) {
            const ChosenTarget chosen(target);
            const FastVolumeCaster fast(scene, scene.volumes[0], {.step = step * pitch});
            const FastVolumeCaster unskipped(scene, scene.volumes[0], {.step = step * pitch, .skip = false});
            FastVolumeCaster::PacketSlabs packet, same;
            std::size_t rays = 0, slabs = 0, far_off = 0;
            double worst = 0, mean = 0;
            for (int y = 0; y < 19; y += 4)
                for (int x = 0; x < 22; x += 4) {
                    fast.cast(x, y, 1, packet);
                    unskipped.cast(x, y, 1, same);
                    for (std::size_t i = 0; i < 16; ++i) {
                        const int px = x + static_cast<int>(i % 4), py = y + static_cast<int>(i / 4);
                        ASSERT_EQ(packet[i].size(), same[i].size());
                        ASSERT_EQ(
                            0, std::memcmp(packet[i].data(), same[i].data(), same[i].size() * sizeof(Slab)));
                        if (px >= 22 || py >= 19) {
                            ASSERT_TRUE(packet[i].empty());
                            continue;
                        }
                        const auto& truth = expected[static_cast<std::size_t>(px + 22 * py)];
                        const Pixel a = composite(packet[i]), b = composite(truth);
                        double off = std::abs(a.clear - b.clear);
                        EXPECT_LT(off, 2e-5);
                        for (int c = 0; c < 3; ++c) off = std::max(off, std::abs(a.color[c] - b.color[c]));
                        worst = std::max(worst, off);
                        mean += off;
                        if (off > bound) ++far_off;
                        ++rays;
                        slabs += packet[i].size();
                        if (!truth.empty() && !packet[i].empty()) {
                            EXPECT_NEAR(packet[i].front().z - packet[i].front().d,
                                        truth.front().z - truth.front().d, 2e-5 + (off > 1e-6 ? 0.5 : 0));
                        }
                        for (std::size_t k = 1; k < packet[i].size(); ++k) {
                            ASSERT_GE(packet[i][k].z - packet[i][k].d, packet[i][k - 1].z);
                        }
                    }
                }
            EXPECT_EQ(rays, 22U * 19U);
            EXPECT_GT(slabs, 500U);
            // Lit: where the middle of a step is on a face of cells, rounding chooses the normal.
            EXPECT_LE(far_off, flat ? 0U : rays / 50) << worst;
            EXPECT_LT(mean / static_cast<double>(rays), 0.25 * bound);
            EXPECT_LT(worst, flat ? bound : 0.05);
        }
    }
}

INSTANTIATE_TEST_SUITE_P(All, FastCaster,
                         testing::Combine(testing::Values(Samples::bytes, Samples::words, Samples::floats,
                                                          Samples::holes),
                                          testing::ValuesIn(kTransfers), testing::Values(kFlat, kLit)));

TEST_P(FastCaster, CollectedSlabsAreThoseOfTheCollector) {
    const auto& [samples, transfer, shading] = GetParam();
    const PreparedScene scene = scene_of(test_folder(), samples, transfer, shading);
    const double pitch = voxel_pitch(scene.volumes[0].to_world());
    std::size_t compressed = 0;
    for (const std::int64_t target : simd_targets()) {
        const ChosenTarget chosen(target);
        const FastVolumeCaster caster(scene, scene.volumes[0], {.step = 0.15 * pitch});
        FastVolumeCaster::PacketSlabs all;
        FastVolumeCaster::CollectedPacket collected;
        for (const auto& [layers, opaque_at, compression] :
             {std::tuple{8, 1.0F, SlabCompression::transmittance}, {2, 0.9F, SlabCompression::transmittance},
              {9, 0.999F, SlabCompression::transmittance}, {10, 1.0F, SlabCompression::transmittance},
              {4, 1.0F, SlabCompression::slope}, {4, 0.5F, SlabCompression::tail}}) {
            const SlabSettings settings{.layers = layers, .compression = compression, .opaque_at = opaque_at};
            const float negligible = layers == 9 ? 0 : SlabCollector::negligible_cost(settings, 0.15 * pitch);
            SlabCollector collector(settings, negligible), expected(settings, negligible);
            for (int y = 0; y < 19; y += 4)
                for (int x = 0; x < 22; x += 4) {
                    caster.cast(x, y, opaque_at, all);
                    caster.cast_collected(x, y, collector, collected);
                    for (std::size_t i = 0; i < kPacketRays; ++i) {
                        expected.start();
                        std::size_t seen = 0;
                        for (const Slab& slab : all[i]) {
                            ++seen;
                            if (!expected.push(slab)) break;
                        }
                        const auto kept = expected.finish();
                        ASSERT_EQ(collected[i].seen, seen);
                        ASSERT_EQ(collected[i].slabs.size(), kept.size());
                        if (kept.empty()) continue;
                        ASSERT_EQ(0, std::memcmp(collected[i].slabs.data(), kept.data(), kept.size_bytes()));
                        ASSERT_EQ(collected[i].nearest, twin::slab_front(all[i].front()));
                        if (seen > 2 * kept.size()) ++compressed;
                    }
                }
        }
    }
    EXPECT_GT(compressed, 500U);
}

TEST(FastMultiVolume, ImagesAreThoseOfThePlainVersion) {
    for (const int volumes : {1, 3})
        for (const SlabMixing mixing :
             {SlabMixing::average, SlabMixing::normalised, SlabMixing::extinction}) {
            const PreparedScene scene =
                scene_of(test_folder(), Samples::bytes, kTransfers[1], kFlat, volumes);
            MultiVolumeStats stats;
            const MultiVolumeSettings settings{.step = 0.8, .mixing = mixing, .rays = 2, .opaque_at = 1};
            MultiVolumeSettings all = settings;
            all.skip = false;
            const Image plain = cast_volumes(scene, settings, stats, [](double) {});
            for (const std::int64_t target : simd_targets()) {
                const ChosenTarget chosen(target);
                const Image fast = cast_volumes_fast(scene, settings, stats, [](double) {});
                expect_same_planes(fast, cast_volumes_fast(scene, all, stats, [](double) {}));
                for (const char* plane : {"R", "G", "B", "A"})
                    for (std::size_t i = 0; i < plain.pixel_count(); ++i)
                        ASSERT_NEAR(fast.plane(plane)[i], plain.plane(plane)[i], 3e-4)
                            << plane << i << " " << volumes;
                std::size_t other = 0;
                for (std::size_t i = 0; i < plain.pixel_count(); ++i) {
                    const float a = fast.plane("Z")[i], b = plain.plane("Z")[i];
                    if (a != b && !(std::abs(a - b) < 1e-4F)) ++other;
                }
                EXPECT_LE(other, plain.pixel_count() / 50);
            }
        }
}

TEST(FastMultiVolume, SurfacesCutStepsAsInThePlainVersion) {
    const fs::path folder = test_folder();
    Scene settings = scene_of(folder, Samples::bytes, kTransfers[0], kFlat, 2).settings;
    Surface iso;
    iso.name = "iso";
    iso.shape = IsosurfaceShape{folder / "v.nrrd", 150};
    iso.opacity = 0.3;
    iso.to_world = settings.volumes[1].to_world;
    settings.surfaces.push_back(iso);
    const PreparedScene scene = prepare(settings);
    // Three planes across the view, two of them at one depth, in a chequerboard of rays.
    const auto planes = [&](int y0, int y1) {
        SurfaceLayers layers;
        layers.first.push_back(0);
        for (int y = 2 * y0; y < 2 * y1; ++y)
            for (int x = 0; x < 44; ++x) {
                if ((x + y) % 2 == 0)
                    for (const Slab& s : {Slab{3.9F, 0, 0.1F, 0, 0, 0.1F}, Slab{5, 0, 0, 0.2F, 0, 0.2F},
                                          Slab{5, 0, 0.3F, 0, 0, 0.4F}})
                        layers.slabs.push_back(s);
                layers.first.push_back(layers.slabs.size());
            }
        return layers;
    };
    MultiVolumeStats stats;
    const MultiVolumeSettings cast{.step = 0.8, .rays = 2, .opaque_at = 1};
    const Image plain = cast_volumes(
        scene, cast, stats, [](double) {}, planes);
    const Image without = cast_volumes(scene, cast, stats, [](double) {});
    double differs = 0;
    for (const std::int64_t target : simd_targets()) {
        const ChosenTarget chosen(target);
        const Image fast = cast_volumes_fast(
            scene, cast, stats, [](double) {}, planes);
        for (const char* plane : {"R", "G", "B", "A"})
            for (std::size_t i = 0; i < plain.pixel_count(); ++i) {
                ASSERT_NEAR(fast.plane(plane)[i], plain.plane(plane)[i], 3e-4) << plane << i;
                differs += static_cast<double>(std::abs(fast.plane(plane)[i] - without.plane(plane)[i]));
            }
    }
    EXPECT_GT(differs, 10);
}

TEST(FastMultiVolume, OtherInterpolationsGoThePlainWay) {
    for (const char* interpolation : {"nearest", "catmull-rom"}) {
        const PreparedScene scene =
            scene_of(test_folder(), Samples::floats, kTransfers[0], kLit, 2, interpolation);
        MultiVolumeStats stats;
        expect_same_planes(cast_volumes_fast(scene, {}, stats, [](double) {}),
                           cast_volumes(scene, {}, stats, [](double) {}));
    }
}

TEST(FastCasterCases, AJumpAtTheValueOfAPlateauShowsIt) {
    // All samples are 128, and the transfer function jumps there: what follows counts, from every direction.
    const fs::path folder = test_folder();
    put_volume(folder / "v.nrrd", {9, 9, 9},
               sampled({9, 9, 9}, [](const Vec3& p) { return p.x == 0 ? 3 : 128; }));
    const PreparedScene scene =
        prepare(scene_from("image.resolution = [4, 4]\n[camera]\nposition = [8.3, 9.1, 30]\ntarget = [5, 4, "
                           "4]\nfov_degrees = 4\n"
                           "[[volume]]\nfile = \"v.nrrd\"\nopacity_step = 8\ntransfer = [[128, 1, 1, 1, 0], "
                           "[128, 1, 1, 1, 0.5]]\n",
                           folder));
    const FastVolumeCaster fast(scene, scene.volumes[0], {.step = 1});
    FastVolumeCaster::PacketSlabs packet;
    fast.cast(0, 0, 1, packet);
    for (std::size_t i = 0; i < 16; ++i) {
        const Ray ray = scene.camera.ray(static_cast<double>(i % 4) + 0.5, static_cast<double>(i / 4) + 0.5);
        EXPECT_NEAR(composite(packet[i]).clear, std::pow(0.5, length(ray.direction) / -ray.direction.z),
                    2e-5);
    }
}

}  // namespace
}  // namespace pellucid
