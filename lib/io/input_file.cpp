#include "io/input_file.hpp"

#include <algorithm>
#include <cctype>
#include <fstream>
#include <system_error>

#include <unistd.h>

#include "core/error.hpp"

namespace pellucid {

std::uint64_t input_file_size(const std::filesystem::path& file) {
    std::error_code error;
    const auto status = std::filesystem::status(file, error);
    if (status.type() == std::filesystem::file_type::not_found)
        throw input_error("{}: no such file", file.string());
    if (error) throw input_error("{}: cannot be read: {}", file.string(), error.message());
    if (status.type() == std::filesystem::file_type::directory)
        throw input_error("{}: is a directory, expected a file", file.string());
    if (status.type() != std::filesystem::file_type::regular)
        throw input_error("{}: is not a regular file", file.string());
    const std::uintmax_t size = std::filesystem::file_size(file, error);
    if (error) throw input_error("{}: cannot be read: {}", file.string(), error.message());
    if (size == 0) throw input_error("{}: is empty", file.string());
    return size;
}

std::string read_input_file(const std::filesystem::path& file, std::uint64_t most_bytes) {
    const std::uint64_t size = std::min(input_file_size(file), most_bytes);
    if (size > available_memory())
        throw input_error("{}: {} bytes do not fit in memory", file.string(), size);
    std::ifstream in(file, std::ios::binary);
    std::string bytes(size, '\0');
    if (!in || !in.read(bytes.data(), static_cast<std::streamsize>(size)))
        throw input_error("{}: cannot be read", file.string());
    return bytes;
}

std::uint64_t available_memory() {
    std::ifstream in("/proc/meminfo");
    for (std::string key; in >> key;) {
        std::uint64_t kibibytes = 0;
        if (key == "MemAvailable:" && in >> kibibytes) return kibibytes * 1024;
        in.ignore(256, '\n');
    }
    const auto pages = sysconf(_SC_AVPHYS_PAGES);
    const auto page_size = sysconf(_SC_PAGESIZE);
    return pages > 0 && page_size > 0
               ? static_cast<std::uint64_t>(pages) * static_cast<std::uint64_t>(page_size)
               : UINT64_MAX;
}

std::string lower_extension(const std::filesystem::path& file) {
    const auto lower = [](std::string text) {
        std::transform(text.begin(), text.end(), text.begin(),
                       [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
        return text;
    };
    const std::string last = lower(file.extension().string());
    return last == ".gz" ? lower(file.stem().extension().string()) + last : last;
}

}  // namespace pellucid
