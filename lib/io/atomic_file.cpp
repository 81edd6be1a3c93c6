#include "io/atomic_file.hpp"

#include <atomic>
#include <fstream>
#include <string>
#include <system_error>

#include <unistd.h>

#include "core/error.hpp"

namespace pellucid {
namespace {

// Unique among processes by pid, among threads by a count.
std::filesystem::path temporary_beside(const std::filesystem::path& target) {
    static std::atomic<unsigned> count{0};
    std::filesystem::path name = target;
    name += fmt::format(".{}.{}.tmp", getpid(), count++);
    return name;
}

struct Temporary {
    std::filesystem::path path;
    bool renamed = false;

    explicit Temporary(std::filesystem::path p) : path(std::move(p)) {}
    Temporary(const Temporary&) = delete;
    Temporary& operator=(const Temporary&) = delete;
    ~Temporary() {
        std::error_code ignored;
        if (!renamed) std::filesystem::remove(path, ignored);
    }
};

}  // namespace

void write_atomically(const std::filesystem::path& target,
                      const std::function<void(const std::filesystem::path& temporary)>& write) {
    std::error_code error;
    const std::filesystem::path folder = target.has_parent_path() ? target.parent_path() : ".";
    if (!std::filesystem::is_directory(folder, error))
        throw run_error("{}: cannot be written: no folder {}", target.string(), folder.string());
    // rename would put a file in the place of an empty folder, or of a device
    const auto there = std::filesystem::status(target, error);
    if (std::filesystem::exists(there) && !std::filesystem::is_regular_file(there))
        throw run_error("{}: cannot be written: is there and is not a regular file", target.string());

    Temporary temporary(temporary_beside(target));
    try {
        write(temporary.path);
    } catch (const Error&) {
        throw;
    } catch (const std::exception& failure) {
        throw run_error("{}: cannot be written: {}", target.string(), failure.what());
    }
    error.clear();
    std::filesystem::rename(temporary.path, target, error);
    if (error) throw run_error("{}: cannot be written: {}", target.string(), error.message());
    temporary.renamed = true;
}

void write_text_file(const std::filesystem::path& target, std::string_view text) {
    write_atomically(target, [&](const std::filesystem::path& temporary) {
        std::ofstream out(temporary, std::ios::binary);
        out.write(text.data(), static_cast<std::streamsize>(text.size()));
        out.close();  // the last bytes go to disk here: a full disk may show only now
        if (!out) throw run_error("{}: cannot be written: disk full, or no permission", target.string());
    });
}

}  // namespace pellucid
