// What readers of text and PLY files share: words, numbers, and the header and rows of a PLY file.
#pragma once

#include <bit>
#include <charconv>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "core/error.hpp"

namespace pellucid::rows {

using Path = std::filesystem::path;

// Words between blanks, with what is left of the text.
class Words {
public:
    explicit Words(std::string_view text, char comment = '\0') : rest_(text), comment_(comment) {}

    // Empty at the end of the text.
    std::string_view next();
    [[nodiscard]] std::string_view rest() const { return rest_; }

    // To the end of the line that the last word stood on.
    void skip_line();

private:
    std::string_view rest_;
    char comment_;
};

// The whole word, a leading + allowed.
template <class T>
[[nodiscard]] bool parse(std::string_view word, T& value) {
    if (word.starts_with('+')) word.remove_prefix(1);
    const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), value);
    return error == std::errc() && end == word.data() + word.size();
}

// A word as part of a message.
[[nodiscard]] std::string shown(std::string_view word);
// A word as a number, or the error that names file and place.
[[nodiscard]] double number(const Path& file, std::string_view word, std::string_view where);

enum class PlyType { none, int8, uint8, int16, uint16, int32, uint32, float32, float64 };

[[nodiscard]] std::size_t bytes_of(PlyType type);

struct PlyProperty {
    std::string name;
    PlyType type = PlyType::none;
    PlyType count_type = PlyType::none;  // of a list
};

struct PlyElement {
    std::string name;
    std::uint64_t count = 0;
    std::vector<PlyProperty> properties;
};

struct PlyHeader {
    bool text = false;
    bool big_endian = false;
    std::vector<PlyElement> elements;
    std::string_view body;
};

/// Throws Error(input), one line, where it is none.
[[nodiscard]] PlyHeader ply_header(const Path& file, std::string_view bytes);
/// No count may exceed what the body could hold if every row were as short as it can be.
void check_ply_counts(const Path& file, const PlyHeader& header);

// Numbers of the body one after the other, text or binary.
class PlyBody {
public:
    PlyBody(const Path& file, const PlyHeader& header)
        : file_(file),
          text_(header.text),
          swapped_(header.big_endian != (std::endian::native == std::endian::big)),
          rest_(header.body),
          words_(header.body) {}

    double next(PlyType type, const PlyElement& element, std::uint64_t row);

private:
    template <class T>
    T binary(const PlyElement& element, std::uint64_t row);
    Error cut_short(const PlyElement& element, std::uint64_t row) const;

    Path file_;
    bool text_;
    bool swapped_;
    std::string_view rest_;
    Words words_;
};

}  // namespace pellucid::rows
