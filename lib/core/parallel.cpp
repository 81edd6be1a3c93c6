#include "core/parallel.hpp"

#include <memory>

#include <oneapi/tbb/blocked_range.h>
#include <oneapi/tbb/global_control.h>
#include <oneapi/tbb/info.h>
#include <oneapi/tbb/parallel_for.h>

namespace pellucid {

void parallel_for(std::size_t count, std::size_t grain,
                  const std::function<void(std::size_t, std::size_t)>& body) {
    using Range = oneapi::tbb::blocked_range<std::size_t>;
    oneapi::tbb::parallel_for(Range(0, count, grain),
                              [&](const Range& piece) { body(piece.begin(), piece.end()); });
}

void set_thread_count(int threads) {
    using oneapi::tbb::global_control;
    static std::unique_ptr<global_control> limit;
    limit.reset();
    const std::size_t count = threads > 0 ? static_cast<std::size_t>(threads)
                                          : static_cast<std::size_t>(oneapi::tbb::info::default_concurrency());
    limit = std::make_unique<global_control>(global_control::max_allowed_parallelism, count);
}

int thread_count() {
    using oneapi::tbb::global_control;
    return static_cast<int>(global_control::active_value(global_control::max_allowed_parallelism));
}

}  // namespace pellucid
