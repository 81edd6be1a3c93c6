// zSlabs: merges in cache, and what a ray pays for a slab.
#pragma once

namespace pellucid::bench {

/// slabs/…
void register_slab_benchmarks();

}  // namespace pellucid::bench
