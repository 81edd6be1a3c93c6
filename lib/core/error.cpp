#include "core/error.hpp"

#include <cstdio>

namespace pellucid {

void warn(const std::string& message) {
    const std::string line = "warning: " + message + "\n";
    std::fputs(line.c_str(), stderr);  // one call: lines of several threads do not mix
}

}  // namespace pellucid
