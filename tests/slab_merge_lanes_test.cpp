#include "cpu/slab_merge_lanes.hpp"

#include <gtest/gtest.h>

#include "simd_targets.hpp"
#include "slab_testing.hpp"
#include "stage/slab_merge.hpp"

namespace pellucid {
namespace {

using namespace testing_slabs;

TEST(SlabMergeLanes, HaveTheBitsOfOnePixelAtATime) {
    RandomSlabs random(1);
    std::vector<SlabArray> a(3'000);
    std::vector<SlabArray> b(a.size());
    for (std::size_t i = 0; i < a.size(); ++i) {
        a[i] = random.array(9);
        b[i] = random.array(i % 7 == 0 ? 0 : 9);
    }
    for (const std::int64_t target : simd_targets()) {
        const ChosenTarget chosen(target);
        for (const SlabInterpolation interpolation : kInterpolations)
            for (const SlabMixing mixing : kMixings)
                for (const float opaque_at : {0.9F, 1.0F, 2.0F}) {
                    const SlabSettings settings{.interpolation = interpolation, .mixing = mixing, .opaque_at = opaque_at};
                    std::vector<SlabArray> out(a.size());
                    std::vector<SlabMergeJob> jobs;
                    for (std::size_t i = 0; i < a.size(); ++i) {
                        out[i].resize(a[i].size() + b[i].size());
                        jobs.push_back({a[i], b[i], out[i]});
                    }
                    SlabMergeLanes(settings).merge(jobs);
                    for (std::size_t i = 0; i < a.size(); ++i) {
                        out[i].resize(jobs[i].count);
                        ASSERT_EQ(out[i], merge_arrays(a[i], b[i], settings)) << target << " " << i;
                    }
                }
    }
}

TEST(SlabMergeLanes, AnyNumberOfJobs) {
    RandomSlabs random(2);
    for (std::size_t count = 0; count < 40; ++count) {
        std::vector<SlabArray> a(count), b(count), out(count);
        std::vector<SlabMergeJob> jobs(count);
        for (std::size_t i = 0; i < count; ++i) {
            a[i] = random.array(3);
            b[i] = random.array(3);
            out[i].resize(a[i].size() + b[i].size());
            jobs[i] = {a[i], b[i], out[i]};
        }
        SlabMergeLanes({}).merge(jobs);
        for (std::size_t i = 0; i < count; ++i) {
            out[i].resize(jobs[i].count);
            ASSERT_EQ(out[i], merge_arrays(a[i], b[i], {}));
        }
    }
}

}  // namespace
}  // namespace pellucid
