#include "io/file_rows.hpp"

#include <algorithm>
#include <array>
#include <utility>

namespace pellucid::rows {
namespace {

bool is_blank(char c) {
    return c == ' ' || (c >= '\t' && c <= '\r');
}

PlyType ply_type(std::string_view name) {
    constexpr std::array<std::pair<std::string_view, PlyType>, 16> kNames = {{
        {"char", PlyType::int8},
        {"int8", PlyType::int8},
        {"uchar", PlyType::uint8},
        {"uint8", PlyType::uint8},
        {"short", PlyType::int16},
        {"int16", PlyType::int16},
        {"ushort", PlyType::uint16},
        {"uint16", PlyType::uint16},
        {"int", PlyType::int32},
        {"int32", PlyType::int32},
        {"uint", PlyType::uint32},
        {"uint32", PlyType::uint32},
        {"float", PlyType::float32},
        {"float32", PlyType::float32},
        {"double", PlyType::float64},
        {"float64", PlyType::float64},
    }};
    const auto found =
        std::find_if(kNames.begin(), kNames.end(), [&](const auto& entry) { return entry.first == name; });
    return found == kNames.end() ? PlyType::none : found->second;
}

}  // namespace

std::string_view Words::next() {
    while (true) {
        const auto begin = std::find_if_not(rest_.begin(), rest_.end(), is_blank);
        rest_.remove_prefix(static_cast<std::size_t>(begin - rest_.begin()));
        if (comment_ == '\0' || !rest_.starts_with(comment_)) break;
        rest_.remove_prefix(std::min(rest_.find('\n'), rest_.size()));
    }
    const auto end = std::find_if(rest_.begin(), rest_.end(), is_blank);
    const std::string_view word = rest_.substr(0, static_cast<std::size_t>(end - rest_.begin()));
    rest_.remove_prefix(word.size());
    return word;
}

void Words::skip_line() {
    rest_.remove_prefix(std::min(rest_.find('\n'), rest_.size()));
}

std::string shown(std::string_view word) {
    return one_line(word.substr(0, 24));
}

double number(const Path& file, std::string_view word, std::string_view where) {
    double value = 0;
    if (word.empty()) throw input_error("{}: is cut short: ends at {}", file.string(), where);
    if (!parse(word, value))
        throw input_error("{}: {}: \"{}\", expected a number", file.string(), where, shown(word));
    return value;
}

std::size_t bytes_of(PlyType type) {
    switch (type) {
        case PlyType::int8:
        case PlyType::uint8:
            return 1;
        case PlyType::int16:
        case PlyType::uint16:
            return 2;
        case PlyType::float64:
            return 8;
        default:
            return 4;
    }
}

PlyHeader ply_header(const Path& file, std::string_view bytes) {
    PlyHeader header;
    if (!bytes.starts_with("ply") || bytes.size() < 4 || !is_blank(bytes[3]))
        throw input_error("{}: not a PLY file: does not begin with \"ply\"", file.string());
    bool has_format = false;
    for (std::string_view rest = bytes;;) {
        const std::size_t end = rest.find('\n');
        if (end == std::string_view::npos)
            throw input_error("{}: is cut short: header without end_header", file.string());
        Words words(rest.substr(0, end));
        rest.remove_prefix(end + 1);
        const std::string_view key = words.next();
        if (key == "end_header") {
            header.body = rest;
            break;
        }
        if (key == "format") {
            const std::string_view format = words.next();
            header.text = format == "ascii";
            header.big_endian = format == "binary_big_endian";
            has_format = header.text || header.big_endian || format == "binary_little_endian";
        } else if (key == "element") {
            PlyElement element{.name = std::string(words.next()), .count = 0, .properties = {}};
            const std::string_view count = words.next();
            if (!parse(count, element.count))
                throw input_error("{}: element {}: count \"{}\", expected an integer", file.string(),
                                  shown(element.name), shown(count));
            header.elements.push_back(std::move(element));
        } else if (key == "property") {
            PlyProperty property;
            std::string_view type = words.next();
            const bool list = type == "list";
            if (list) {
                property.count_type = ply_type(words.next());
                type = words.next();
            }
            property.type = ply_type(type);
            property.name = words.next();
            if (property.type == PlyType::none || (list && property.count_type == PlyType::none) ||
                header.elements.empty())
                throw input_error("{}: property \"{}\" is of an unknown type", file.string(),
                                  shown(property.name));
            header.elements.back().properties.push_back(std::move(property));
        } else if (!key.empty() && key != "ply" && key != "comment" && key != "obj_info") {
            throw input_error("{}: header line \"{}\" is unknown", file.string(), shown(key));
        }
    }
    if (!has_format) throw input_error("{}: has no known format line", file.string());
    return header;
}

void check_ply_counts(const Path& file, const PlyHeader& header) {
    for (const PlyElement& element : header.elements) {
        std::uint64_t row_bytes = 0;
        for (const PlyProperty& property : element.properties) {
            const bool list = property.count_type != PlyType::none;
            row_bytes += header.text ? 2 : bytes_of(list ? property.count_type : property.type);
        }
        if (element.count > header.body.size() / std::max<std::uint64_t>(row_bytes, 1) + 1)
            throw input_error("{}: is cut short: claims {} rows of {}, {} bytes are there", file.string(),
                              element.count, shown(element.name), header.body.size());
    }
}

template <class T>
T PlyBody::binary(const PlyElement& element, std::uint64_t row) {
    std::array<char, sizeof(T)> one;
    if (rest_.size() < sizeof(T)) throw cut_short(element, row);
    std::copy_n(rest_.data(), sizeof(T), one.begin());
    rest_.remove_prefix(sizeof(T));
    if (swapped_) std::reverse(one.begin(), one.end());
    T value;
    std::memcpy(&value, one.data(), sizeof(T));
    return value;
}

Error PlyBody::cut_short(const PlyElement& element, std::uint64_t row) const {
    return input_error("{}: is cut short: ends at {} {} of {}", file_.string(), shown(element.name), row,
                       element.count);
}

double PlyBody::next(PlyType type, const PlyElement& element, std::uint64_t row) {
    if (text_) {
        const std::string_view word = words_.next();
        double value = 0;
        if (word.empty()) throw cut_short(element, row);
        if (!parse(word, value))
            throw input_error("{}: {} {}: \"{}\", expected a number", file_.string(), shown(element.name),
                              row, shown(word));
        return value;
    }
    switch (type) {
        case PlyType::int8:
            return binary<std::int8_t>(element, row);
        case PlyType::uint8:
            return binary<std::uint8_t>(element, row);
        case PlyType::int16:
            return binary<std::int16_t>(element, row);
        case PlyType::uint16:
            return binary<std::uint16_t>(element, row);
        case PlyType::int32:
            return binary<std::int32_t>(element, row);
        case PlyType::uint32:
            return binary<std::uint32_t>(element, row);
        case PlyType::float64:
            return binary<double>(element, row);
        default:
            return static_cast<double>(binary<float>(element, row));
    }
}

}  // namespace pellucid::rows
