#include "core/error.hpp"

#include <cstdio>

namespace pellucid {

std::string one_line(std::string_view text, std::size_t limit) {
    const bool cut = text.size() > limit;
    std::size_t end = cut ? limit : text.size();
    // Not in the middle of a character: continuation bytes of UTF-8 are 10xxxxxx.
    while (cut && end > 0 && (static_cast<unsigned char>(text[end]) & 0xC0U) == 0x80U) --end;
    std::string line;
    bool blank = false;
    for (const char c : text.substr(0, end)) {
        const bool control = static_cast<unsigned char>(c) < 0x20 || c == 0x7f;
        if (!control && blank && !line.empty()) line += ' ';
        if (!control) line += c;
        blank = control;
    }
    if (cut) line += "…";
    return line;
}

void warn(const std::string& message) {
    const std::string line = "warning: " + message + "\n";
    std::fputs(line.c_str(), stderr);  // one call: lines of several threads do not mix
}

}  // namespace pellucid
