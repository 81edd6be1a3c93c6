#include "core/parallel.hpp"

#include <algorithm>
#include <atomic>
#include <exception>
#include <memory>
#include <thread>
#include <vector>

#include <oneapi/tbb/blocked_range.h>
#include <oneapi/tbb/global_control.h>
#include <oneapi/tbb/info.h>
#include <oneapi/tbb/parallel_for.h>

namespace pellucid {

#if defined(__SANITIZE_THREAD__)

// The thread sanitizer cannot see into Debian's oneTBB and takes every hand-over of work there for a
// race. With plain threads it sees exactly the order that parallel_for promises, so it judges ours.
void parallel_for(std::size_t count, std::size_t grain,
                  const std::function<void(std::size_t, std::size_t)>& body) {
    const auto workers = static_cast<std::size_t>(thread_count());
    const std::size_t piece = std::max(grain, (count + 4 * workers - 1) / (4 * workers));
    std::atomic<std::size_t> next = 0;
    std::vector<std::exception_ptr> errors(workers);
    const auto work = [&](std::size_t worker) {
        try {
            for (std::size_t begin = next.fetch_add(piece); begin < count; begin = next.fetch_add(piece))
                body(begin, std::min(begin + piece, count));
        } catch (...) {
            errors[worker] = std::current_exception();
            next = count;
        }
    };
    std::vector<std::thread> threads;
    for (std::size_t worker = 1; worker < workers; ++worker) threads.emplace_back(work, worker);
    work(0);
    for (std::thread& thread : threads) thread.join();
    for (const std::exception_ptr& error : errors)
        if (error) std::rethrow_exception(error);
}

#else

void parallel_for(std::size_t count, std::size_t grain,
                  const std::function<void(std::size_t, std::size_t)>& body) {
    using Range = oneapi::tbb::blocked_range<std::size_t>;
    oneapi::tbb::parallel_for(Range(0, count, grain),
                              [&](const Range& piece) { body(piece.begin(), piece.end()); });
}

#endif

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
