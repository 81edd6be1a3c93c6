#include "io/voxel_stream.hpp"

#include <algorithm>
#include <charconv>
#include <cstring>
#include <memory>
#include <new>
#include <system_error>

#include <fcntl.h>
#include <unistd.h>
#include <zlib.h>

#include "core/error.hpp"
#include "io/input_file.hpp"

namespace pellucid {
namespace {

constexpr std::size_t kPiece = std::size_t{1} << 20;  // bytes read at a time; a multiple of every sample

// Bytes of a file in order, decompressed or as they are.
class ByteStream {
public:
    ByteStream(const std::filesystem::path& file, std::uint64_t begin, bool gzip) : file_(file) {
        descriptor_ = open(file.c_str(), O_RDONLY | O_CLOEXEC);
        if (descriptor_ < 0 || lseek(descriptor_, static_cast<off_t>(begin), SEEK_SET) < 0) {
            if (descriptor_ >= 0) close(descriptor_);
            throw input_error("{}: cannot be read", file.string());
        }
        if (!gzip) return;
        gz_ = gzdopen(descriptor_, "rb");
        if (gz_ == nullptr) {
            close(descriptor_);
            throw run_error("{}: zlib has no memory", file.string());
        }
        gzbuffer(gz_, 1 << 17);
        if (gzdirect(gz_) != 0) {
            gzclose_r(gz_);
            throw input_error("{}: the data are not in gzip format", file.string());
        }
    }
    ByteStream(const ByteStream&) = delete;
    ByteStream& operator=(const ByteStream&) = delete;
    ~ByteStream() {
        if (gz_ != nullptr)
            gzclose_r(gz_);
        else
            close(descriptor_);
    }

    // As many bytes as there are up to `count`; Error(input) where the data are damaged.
    std::size_t read(char* to, std::size_t count) {
        std::size_t got = 0;
        while (got < count) {
            const auto ask = static_cast<unsigned>(std::min(count - got, kPiece));
            const std::int64_t more =
                gz_ != nullptr ? gzread(gz_, to + got, ask) : ::read(descriptor_, to + got, ask);
            if (more < 0 || (more == 0 && gz_damaged()))
                throw input_error("{}: {}", file_.string(), trouble());
            if (more == 0) break;
            got += static_cast<std::size_t>(more);
        }
        return got;
    }

private:
    bool gz_damaged() const {
        int code = Z_OK;
        if (gz_ != nullptr) gzerror(gz_, &code);
        return code != Z_OK;
    }
    std::string trouble() const {
        int code = Z_ERRNO;
        const char* text = gz_ != nullptr ? gzerror(gz_, &code) : "";
        if (code == Z_BUF_ERROR) return "the compressed data are cut short";
        if (code == Z_ERRNO) return "cannot be read";
        return "the compressed data are damaged: " + one_line(text);
    }

    std::filesystem::path file_;
    int descriptor_ = -1;
    gzFile gz_ = nullptr;
};

template <class T>
void append(std::span<const char> bytes, const SampleSource& source, std::vector<float>& values) {
    for (std::size_t at = 0; at < bytes.size(); at += sizeof(T)) {
        std::array<char, sizeof(T)> one;
        std::copy_n(bytes.data() + at, sizeof(T), one.begin());
        if (source.swapped) std::reverse(one.begin(), one.end());
        T stored;
        std::memcpy(&stored, one.data(), sizeof(T));
        values.push_back(static_cast<float>(source.slope * static_cast<double>(stored) + source.intercept));
    }
}

void append(std::span<const char> bytes, const SampleSource& source, std::vector<float>& values) {
    switch (source.type) {
        case SampleType::int8:
            return append<std::int8_t>(bytes, source, values);
        case SampleType::uint8:
            return append<std::uint8_t>(bytes, source, values);
        case SampleType::int16:
            return append<std::int16_t>(bytes, source, values);
        case SampleType::uint16:
            return append<std::uint16_t>(bytes, source, values);
        case SampleType::int32:
            return append<std::int32_t>(bytes, source, values);
        case SampleType::uint32:
            return append<std::uint32_t>(bytes, source, values);
        case SampleType::int64:
            return append<std::int64_t>(bytes, source, values);
        case SampleType::uint64:
            return append<std::uint64_t>(bytes, source, values);
        case SampleType::float32:
            return append<float>(bytes, source, values);
        case SampleType::float64:
            return append<double>(bytes, source, values);
    }
}

void check_claim(const SampleSource& source, std::uint64_t count) {
    const std::uint64_t file_bytes = input_file_size(source.file);
    const std::uint64_t there = file_bytes - std::min(file_bytes, source.begin);
    // count < 2^62, so in units of one sample nothing overflows; text: a digit and a blank each
    std::uint64_t most = there / bytes_of(source.type);
    if (source.encoding == SampleEncoding::gzip) most = there * kMostInflation / bytes_of(source.type);
    if (source.encoding == SampleEncoding::text) most = there / 2 + 1;
    if (count > most)
        throw input_error(
            "{}: is cut short: the header claims {} samples of {} bytes, {} bytes of {}data are there",
            source.file.string(), count, bytes_of(source.type), there,
            source.encoding == SampleEncoding::gzip ? "compressed " : "");
    if (count > available_memory() / sizeof(float))
        throw input_error("{}: {} samples do not fit in memory", source.file.string(), count);
}

void skip_bytes(ByteStream& stream, const SampleSource& source) {
    std::vector<char> piece(std::min<std::uint64_t>(kPiece, source.skip));
    for (std::uint64_t left = source.skip; left > 0;) {
        const std::size_t got = stream.read(piece.data(), std::min<std::uint64_t>(piece.size(), left));
        if (got == 0)
            throw input_error("{}: is cut short: ends before the first sample", source.file.string());
        left -= got;
    }
}

// Reads to the end, because the checksum is there, and tells what was too much.
void finish(ByteStream& stream, const SampleSource& source) {
    constexpr std::uint64_t kMostLeftOver = std::uint64_t{1}
                                            << 26;  // what decompresses without end is no volume
    std::vector<char> piece(kPiece);
    std::uint64_t left_over = 0;
    for (std::size_t got = 1; got > 0; left_over += got) {
        got = stream.read(piece.data(), piece.size());
        if (left_over > kMostLeftOver)
            throw input_error("{}: goes on for more than {} bytes after the last sample",
                              source.file.string(), kMostLeftOver);
    }
    if (left_over > 0)
        warn("{}: {} bytes after the last sample are not used", source.file.string(), left_over);
}

std::vector<float> read_binary(const SampleSource& source, std::uint64_t count) {
    ByteStream stream(source.file, source.begin, source.encoding == SampleEncoding::gzip);
    skip_bytes(stream, source);
    std::vector<float> values;
    values.reserve(count);  // pages are touched only as data come
    const std::uint64_t wanted = count * bytes_of(source.type);
    std::vector<char> piece(std::min<std::uint64_t>(kPiece, wanted));
    for (std::uint64_t left = wanted; left > 0;) {
        const std::size_t ask = std::min<std::uint64_t>(piece.size(), left);
        const std::size_t got = stream.read(piece.data(), ask);
        if (got < ask)
            throw input_error("{}: is cut short: {} of {} bytes of samples are there", source.file.string(),
                              wanted - left + got, wanted);
        append(std::span(piece).first(got), source, values);
        left -= got;
    }
    finish(stream, source);
    return values;
}

std::vector<float> read_text(const SampleSource& source, std::uint64_t count) {
    const std::string text = read_input_file(source.file);
    std::vector<float> values;
    values.reserve(count);
    const char* at = text.data() + std::min<std::uint64_t>(source.begin + source.skip, text.size());
    const char* const end = text.data() + text.size();
    const auto is_blank = [](char c) { return c == ' ' || c == ',' || (c >= '\t' && c <= '\r'); };
    while (true) {
        while (at < end && is_blank(*at)) ++at;
        if (at == end || values.size() == count) break;
        double stored = 0;
        const auto [after, error] = std::from_chars(*at == '+' ? at + 1 : at, end, stored);
        if (error != std::errc() || (after < end && !is_blank(*after)))
            throw input_error("{}: sample {} = \"{}\", expected a number", source.file.string(),
                              values.size(),
                              one_line(std::string_view(
                                  at, static_cast<std::size_t>(std::min<std::ptrdiff_t>(end - at, 12)))));
        values.push_back(static_cast<float>(source.slope * stored + source.intercept));
        at = after;
    }
    if (values.size() < count)
        throw input_error("{}: is cut short: {} of {} samples are there", source.file.string(), values.size(),
                          count);
    if (at < end) warn("{}: {} bytes after the last sample are not used", source.file.string(), end - at);
    return values;
}

}  // namespace

std::uint64_t bytes_of(SampleType type) {
    switch (type) {
        case SampleType::int8:
        case SampleType::uint8:
            return 1;
        case SampleType::int16:
        case SampleType::uint16:
            return 2;
        case SampleType::int32:
        case SampleType::uint32:
        case SampleType::float32:
            return 4;
        case SampleType::int64:
        case SampleType::uint64:
        case SampleType::float64:
            return 8;
    }
    return 1;
}

std::uint64_t voxel_count(const std::filesystem::path& file, std::span<const std::uint64_t, 3> size) {
    constexpr std::uint64_t kMost = std::uint64_t{1} << 62;
    std::uint64_t count = 1;
    for (const std::uint64_t n : size) {
        if (n > INT32_MAX || count > kMost / n)
            throw input_error("{}: claims {} x {} x {} samples, more than any file holds", file.string(),
                              size[0], size[1], size[2]);
        count *= n;
    }
    return count;
}

std::vector<float> read_samples(const SampleSource& source, std::uint64_t count) {
    check_claim(source, count);
    try {
        return source.encoding == SampleEncoding::text ? read_text(source, count)
                                                       : read_binary(source, count);
    } catch (const std::bad_alloc&) {
        throw input_error("{}: {} samples do not fit in memory", source.file.string(), count);
    }
}

std::string read_decompressed(const std::filesystem::path& file, std::uint64_t most_bytes) {
    ByteStream stream(file, 0, is_gzip(file));
    std::string bytes(most_bytes, '\0');
    bytes.resize(stream.read(bytes.data(), bytes.size()));
    return bytes;
}

bool is_gzip(const std::filesystem::path& file) {
    return read_input_file(file, 2) == "\x1f\x8b";
}

}  // namespace pellucid
