// Where a result comes from: commit, compiler, machine, time.
#pragma once

#include <cstdint>
#include <string>

namespace pellucid {

/// What was built. "unknown" for what could not be found out.
struct BuildInfo {
    std::string version;   // "0.1.0"
    std::string commit;    // as of the last build; "-dirty" after it where tracked files differed
    std::string compiler;  // "GNU 12.2.0"
    std::string flags;
    std::string build_type;  // "Release"
};
[[nodiscard]] BuildInfo build_info();

/// What it runs on.
struct HostInfo {
    std::string cpu;  // model name
    int cores = 0;    // logical processors that this process may use
    std::uint64_t memory_bytes = 0;
    std::string os;  // distribution, kernel and architecture
};
[[nodiscard]] HostInfo host_info();

/// "2026-01-31T12:00:00Z"
[[nodiscard]] std::string utc_now();

/// Largest resident set of this process so far.
[[nodiscard]] std::uint64_t peak_rss_bytes();

}  // namespace pellucid
