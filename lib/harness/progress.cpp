#include "harness/progress.hpp"

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <cstring>

#include <fmt/format.h>
#include <unistd.h>

namespace pellucid {

bool on_terminal() {
    const char* kind = std::getenv("TERM");
    return isatty(STDERR_FILENO) != 0 && kind != nullptr && std::strcmp(kind, "dumb") != 0;
}

std::string progress_line(const std::string& label, std::size_t done, std::size_t total, double seconds) {
    constexpr std::size_t kBar = 24;
    const double part =
        total == 0 ? 1.0 : std::min(1.0, static_cast<double>(done) / static_cast<double>(total));
    std::string bar(kBar, ' ');
    std::fill_n(bar.begin(), static_cast<std::size_t>(part * static_cast<double>(kBar)), '#');
    std::string line = fmt::format("{} [{}] {}/{}", label, bar, done, total);
    if (done == 0 || seconds <= 0) return line;
    const double rate = static_cast<double>(done) / seconds;
    const double left = static_cast<double>(total - std::min(done, total)) / rate;
    line += fmt::format("  {:.3g}/s", rate);
    if (left < 120) return line + fmt::format("  {:.0f} s left", left);
    if (left < 7200) return line + fmt::format("  {:.0f} min left", left / 60);
    return line + fmt::format("  {:.1f} h left", left / 3600);
}

Progress::Progress(std::string label, std::size_t total, bool shown)
    : label_(std::move(label)), total_(total), shown_(shown) {}

Progress::~Progress() {
    if (shown_ && drawn_ != Clock::time_point{}) std::fputs("\r\033[K", stderr);
}

void Progress::step(std::size_t steps) {
    if (!shown_) return;
    const std::lock_guard lock(mutex_);
    done_ += steps;
    const Clock::time_point now = Clock::now();
    if (drawn_ != Clock::time_point{} && now - drawn_ < std::chrono::milliseconds(100)) return;
    drawn_ = now;
    const double seconds = std::chrono::duration<double>(now - start_).count();
    const std::string line = "\r\033[K" + progress_line(label_, done_, total_, seconds);
    std::fputs(line.c_str(), stderr);
    std::fflush(stderr);
}

}  // namespace pellucid
