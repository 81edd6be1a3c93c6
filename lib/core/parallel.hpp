// Parallel loops over index ranges; oneTBB underneath, kept out of this header.
#pragma once

#include <cstddef>
#include <functional>

namespace pellucid {

/// Calls body(begin, end) on disjoint pieces that together are [0, count), on several threads.
/// Which thread takes which piece is not defined: results must not depend on it. An exception of
/// one piece is rethrown here.
///   grain  pieces are not split below this many indices, >= 1
void parallel_for(std::size_t count, std::size_t grain,
                  const std::function<void(std::size_t begin, std::size_t end)>& body);

/// Most threads that parallel_for uses from now on; 0 = all cores.
void set_thread_count(int threads);
[[nodiscard]] int thread_count();

}  // namespace pellucid
