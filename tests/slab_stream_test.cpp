#include "stage/slab_stream.hpp"

#include <gtest/gtest.h>

#include "slab_testing.hpp"
#include "stage/slab_merge.hpp"

namespace pellucid {
namespace {

using namespace testing_slabs;

TEST(SlabStream, IsTheMergeOfBothArrays) {
    RandomSlabs random(1);
    for (const SlabInterpolation interpolation : kInterpolations)
        for (const SlabMixing mixing : kMixings)
            for (int i = 0; i < 5'000; ++i) {
                const SlabArray array = random.array(7);
                const SlabArray ray = random.array(12);
                const SlabSettings settings{.layers = 40,
                                            .interpolation = interpolation,
                                            .mixing = mixing,
                                            .compression = SlabCompression::tail,
                                            .opaque_at = i % 2 == 0 ? 0.999F : 0.7F};
                SlabCollector collector(settings);
                SlabStream stream(settings, collector);
                stream.start(array);
                for (const Slab& slab : ray)
                    if (!stream.push(slab)) break;
                const auto kept = stream.finish();
                ASSERT_EQ(SlabArray(kept.begin(), kept.end()), merge_arrays(array, ray, settings));
            }
}

}  // namespace
}  // namespace pellucid
