#include "harness/provenance.hpp"

#include <algorithm>
#include <ctime>
#include <fstream>

#include <sched.h>
#include <sys/resource.h>
#include <sys/utsname.h>
#include <unistd.h>

#include "pellucid_build.hpp"  // written at each build: cmake/write_build_header.cmake

namespace pellucid {

namespace {

/// The rest of the first line of `file` that starts with `key`, without separators and quotes.
std::string line_of(const char* file, const std::string& key) {
    std::ifstream in(file);
    for (std::string line; std::getline(in, line);) {
        if (line.compare(0, key.size(), key) != 0) continue;
        const std::size_t begin = line.find_first_not_of(" \t:=\"", key.size());
        const std::size_t end = line.find_last_not_of(" \t\"");
        if (begin != std::string::npos && end >= begin) return line.substr(begin, end - begin + 1);
    }
    return "unknown";
}

}  // namespace

BuildInfo build_info() {
    return {.version = PELLUCID_VERSION,
            .commit = PELLUCID_COMMIT,
            .compiler = PELLUCID_COMPILER,
            .flags = PELLUCID_CXX_FLAGS,
            .build_type = PELLUCID_BUILD_TYPE};
}

HostInfo host_info() {
    HostInfo host;
    host.cpu = line_of("/proc/cpuinfo", "model name");
    cpu_set_t allowed;
    host.cores = sched_getaffinity(0, sizeof allowed, &allowed) == 0
                     ? CPU_COUNT(&allowed)
                     : static_cast<int>(std::max(1L, sysconf(_SC_NPROCESSORS_ONLN)));
    const long pages = sysconf(_SC_PHYS_PAGES);
    const long page = sysconf(_SC_PAGESIZE);
    if (pages > 0 && page > 0)
        host.memory_bytes = static_cast<std::uint64_t>(pages) * static_cast<std::uint64_t>(page);
    host.os = line_of("/etc/os-release", "PRETTY_NAME");
    utsname name{};
    if (uname(&name) == 0)
        host.os += std::string(", ") + name.sysname + " " + name.release + " " + name.machine;
    return host;
}

std::string utc_now() {
    const std::time_t now = std::time(nullptr);
    std::tm parts{};
    gmtime_r(&now, &parts);
    char text[32];
    const std::size_t length = std::strftime(text, sizeof text, "%Y-%m-%dT%H:%M:%SZ", &parts);
    return {text, length};
}

std::uint64_t peak_rss_bytes() {
    rusage usage{};
    if (getrusage(RUSAGE_SELF, &usage) != 0) return 0;
    return static_cast<std::uint64_t>(usage.ru_maxrss) * 1024;  // Linux counts in KiB
}

}  // namespace pellucid
