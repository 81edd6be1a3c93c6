// A bar with rate and time left, on a terminal; elsewhere nothing.
#pragma once

#include <chrono>
#include <cstddef>
#include <mutex>
#include <string>

namespace pellucid {

/// True where stderr is a terminal that takes a bar.
[[nodiscard]] bool on_terminal();

/// Draws on stderr at most ten times a second and wipes the line at the end. `step` may be called
/// from several threads.
class Progress {
public:
    /// `shown` = false: draws nothing, ever.
    Progress(std::string label, std::size_t total, bool shown);
    ~Progress();
    Progress(const Progress&) = delete;
    Progress& operator=(const Progress&) = delete;
    void step(std::size_t steps = 1);

private:
    using Clock = std::chrono::steady_clock;
    std::string label_;
    std::size_t total_;
    std::size_t done_ = 0;
    bool shown_;
    Clock::time_point start_ = Clock::now();
    Clock::time_point drawn_{};
    std::mutex mutex_;
};

/// What the bar looks like: "draw [#####     ] 50/100  10/s  5 s left".
[[nodiscard]] std::string progress_line(const std::string& label, std::size_t done, std::size_t total,
                                        double seconds);

}  // namespace pellucid
