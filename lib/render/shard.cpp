#include "render/shard.hpp"

#include <algorithm>
#include <array>
#include <bit>
#include <charconv>
#include <cmath>
#include <cstdlib>
#include <fstream>
#include <set>
#include <string_view>
#include <utility>
#include <variant>
#include <vector>

#include <fmt/ranges.h>

#include "core/error.hpp"
#include "io/image_file.hpp"
#include "io/input_file.hpp"

namespace pellucid {
namespace {

namespace fs = std::filesystem;

static_assert(std::endian::native == std::endian::little, "the low word of a sum is taken to be the first");

constexpr std::string_view kPart = "shard";
constexpr std::string_view kRepeats = "shard.repeats";
constexpr std::string_view kNear = "shard.near";
constexpr std::string_view kExponent = "shard.exponent";
constexpr std::string_view kUnits = "shard.units";
constexpr std::string_view kParticles = "shard.particles";
constexpr std::string_view kInput = "shard.input";
constexpr std::string_view kChecksum = "shard.checksum";
constexpr std::string_view kDevice = "device";

/// In these the shards of one image may differ.
constexpr std::array kOwn{kPart, kRepeats, kParticles, kChecksum, kDevice};

/// A checksum that any change of one word changes: each step is a bijection of the state.
class Digest {
public:
    void add(std::uint64_t word) {
        state_ = (state_ ^ word) * 0x9e3779b97f4a7c15U;
        state_ ^= state_ >> 32U;
    }
    void add(std::string_view text) {
        add(text.size());
        for (std::size_t i = 0; i < text.size(); i += 8) {
            std::uint64_t word = 0;
            for (std::size_t k = i; k < std::min(i + 8, text.size()); ++k)
                word = word << 8U | static_cast<unsigned char>(text[k]);
            add(word);
        }
    }
    [[nodiscard]] std::uint64_t value() const { return state_; }

private:
    std::uint64_t state_ = 0x243f6a8885a308d3U;
};

void add_file(Digest& digest, const fs::path& file) {
    digest.add(input_file_size(file));
    std::ifstream in(file, std::ios::binary);
    std::string block(std::size_t{1} << 20U, '\0');
    while (in.read(block.data(), static_cast<std::streamsize>(block.size())), in.gcount() > 0)
        digest.add(std::string_view(block).substr(0, static_cast<std::size_t>(in.gcount())));
    if (in.bad()) throw input_error("{}: cannot be read", file.string());
}

void add_file_of(Digest& digest, const ImplicitShape&) { digest.add(0); }
void add_file_of(Digest& digest, const ExpressionShape&) { digest.add(0); }
void add_file_of(Digest& digest, const IsosurfaceShape& shape) { add_file(digest, shape.volume); }
void add_file_of(Digest& digest, const MeshShape& shape) { add_file(digest, shape.file); }
void add_file_of(Digest& digest, const PointsShape& shape) { add_file(digest, shape.file); }
void add_file_of(Digest& digest, const SliceShape& shape) { add_file(digest, shape.volume); }
void add_file_of(Digest& digest, const RectangleShape& shape) {
    if (shape.image) add_file(digest, *shape.image);
}

/// Calls visit(name, first word) for each plane of words that the pixels are made of.
template <class Pixel, class Visit>
void for_each_plane(Pixel& pixel, const Visit& visit) {
    constexpr std::array<const char*, 3> kChannels{"R", "G", "B"};
    using Word = std::conditional_t<std::is_const_v<Pixel>, const std::uint32_t, std::uint32_t>;
    for (std::size_t c = 0; c < kChannels.size(); ++c) {
        auto* const color = reinterpret_cast<Word*>(&pixel.color[c]);  // read and written by OpenEXR as bytes
        auto* const square = reinterpret_cast<Word*>(&pixel.square[c]);
        visit(fmt::format("shard.{}.low", kChannels[c]), color);
        visit(fmt::format("shard.{}.high", kChannels[c]), color + 1);
        visit(fmt::format("shard.{}2.low", kChannels[c]), square);
        visit(fmt::format("shard.{}2.high", kChannels[c]), square + 1);
    }
    visit("shard.covered", &pixel.covered);
    visit("shard.depth", &pixel.depth);
}

/// Of all that a merge takes from a shard: its size, its sums and its attributes but this one.
[[nodiscard]] std::string checksum(int width, int height,
                                   const std::map<std::string, std::string>& attributes,
                                   const EnsembleSums& sums) {
    Digest digest;
    digest.add(static_cast<std::uint64_t>(width));
    digest.add(static_cast<std::uint64_t>(height));
    for (const auto& [name, value] : attributes) {
        if (name == kChecksum) continue;
        digest.add(name);
        digest.add(value);
    }
    for (const EnsembleSums::Pixel& p : sums.pixels) {
        for (const std::uint64_t color : p.color) digest.add(color);
        for (const std::uint64_t square : p.square) digest.add(square);
        digest.add(std::uint64_t{p.covered} << 32U | p.depth);
    }
    return fmt::format("{:016x}", digest.value());
}

/// A decimal number of digits alone.
template <class Number>
[[nodiscard]] std::optional<Number> whole_number(std::string_view text) {
    Number value{};
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
    if (error != std::errc{} || end != text.data() + text.size() || fmt::to_string(value) != text)
        return std::nullopt;
    return value;
}

/// A double as fmt's {:a} writes it.
[[nodiscard]] std::optional<double> exact_number(const std::string& text) {
    const double value = std::strtod(text.c_str(), nullptr);
    if (!std::isfinite(value) || fmt::format("{:a}", value) != text) return std::nullopt;
    return value;
}

[[nodiscard]] std::string repeats_text(RepeatRange range, std::uint32_t all) {
    return fmt::format("{} to {} of {}", range.first, range.end - 1, all);
}

class AttributeReader {
public:
    explicit AttributeReader(const ShardHeader& header) : header_(header) {}

    [[nodiscard]] const std::string& text(std::string_view name) const {
        const auto found = header_.attributes.find(std::string(name));
        if (found == header_.attributes.end())
            throw input_error(
                "{}: is not the file of a shard: has no attribute {}, expected what render --shard writes",
                header_.file.string(), name);
        return found->second;
    }
    template <class Read>
    [[nodiscard]] auto value(std::string_view name, const char* expected, const Read& read) const {
        const auto value = read(text(name));
        if (!value) throw error(name, expected);
        return *value;
    }
    [[nodiscard]] Error error(std::string_view name, std::string_view expected) const {
        return input_error("{}: {} = {}, expected {}", header_.file.string(), name, one_line(text(name), 60),
                           expected);
    }

private:
    const ShardHeader& header_;
};

/// Two values of an attribute from shortly before their first difference: a whole configuration is long.
[[nodiscard]] std::pair<std::string, std::string> differing_parts(const std::string& a,
                                                                  const std::string& b) {
    constexpr std::size_t kBefore = 30;
    constexpr std::size_t kMost = 80;
    const auto first =
        static_cast<std::size_t>(std::mismatch(a.begin(), a.end(), b.begin(), b.end()).first - a.begin());
    if (std::max(a.size(), b.size()) <= kMost || first <= kBefore)
        return {one_line(a, kMost), one_line(b, kMost)};
    const auto from = [&](const std::string& text) {
        return "…" + one_line(text.substr(first - kBefore), kMost);
    };
    return {from(a), from(b)};
}

/// `value` and `other` are attribute `name` of two files, null where there is none.
[[nodiscard]] Error difference(const ShardHeader& a, const ShardHeader& b, const std::string& name,
                               const std::string* value, const std::string* other) {
    if (value == nullptr || other == nullptr)
        return input_error("{}: {} attribute {}, expected {} as in {}", a.file.string(),
                           value == nullptr ? "has no" : "has an", one_line(name, 60),
                           value == nullptr ? "one" : "none", b.file.string());
    const auto [here, there] = differing_parts(*value, *other);
    return input_error("{}: {} = {}, expected {} as in {}: not of the same image", a.file.string(),
                       one_line(name, 60), here, there, b.file.string());
}

/// Throws where the two cannot be parts of one image.
void require_same_image(const ShardHeader& a, const ShardHeader& b) {
    if (a.width != b.width || a.height != b.height)
        throw input_error("{}: has {} x {} pixels, expected {} x {} as in {}", a.file.string(), a.width,
                          a.height, b.width, b.height, b.file.string());
    if (a.part.count != b.part.count)
        throw input_error("{}: is shard {}, expected one of {} as in {}", a.file.string(), a.part.text(),
                          b.part.count, b.file.string());
    std::set<std::string> names;
    for (const ShardHeader* each : {&a, &b})
        for (const auto& [name, value] : each->attributes) names.insert(name);
    for (const std::string& name : names) {
        if (std::find(kOwn.begin(), kOwn.end(), name) != kOwn.end()) continue;
        const auto in_a = a.attributes.find(name);
        const auto in_b = b.attributes.find(name);
        const std::string* const value = in_a == a.attributes.end() ? nullptr : &in_a->second;
        const std::string* const other = in_b == b.attributes.end() ? nullptr : &in_b->second;
        if (value == nullptr || other == nullptr || *value != *other)
            throw difference(a, b, name, value, other);
    }
    if (a.all_repeats != b.all_repeats)
        throw input_error("{}: {} = {}, expected as many in all as in {}: {}", a.file.string(), kRepeats,
                          a.attributes.at(std::string(kRepeats)), b.file.string(), b.all_repeats);
}

/// Throws where a shard is missing or there twice. Precondition: all are of one image.
void require_each_once(const std::vector<ShardHeader>& headers) {
    std::map<std::uint32_t, const ShardHeader*> by_index;
    for (const ShardHeader& header : headers) {
        const auto [there, is_new] = by_index.try_emplace(header.part.index, &header);
        if (!is_new)
            throw input_error("{}: is shard {}, and so is {}: expected each once", header.file.string(),
                              header.part.text(), there->second->file.string());
    }
    const std::uint32_t count = headers.front().part.count;
    if (by_index.size() == count) return;
    constexpr std::size_t kMostNamed = 8;
    std::string missing;
    std::size_t named = 0;
    for (std::uint32_t i = 0; i < count && named < kMostNamed; ++i)
        if (!by_index.contains(i))
            missing += fmt::format("{}{}", named++ == 0 ? "" : ", ", ShardPart{i, count}.text());
    const std::size_t absent = count - by_index.size();
    if (absent > named) missing += ", …";
    throw input_error("{}: is one of {} shards, {} of them {} missing: {}", headers.front().file.string(),
                      count, absent, absent == 1 ? "is" : "are", missing);
}

[[nodiscard]] bool of_shards_alone(std::string_view attribute) {
    return attribute == kPart || attribute.starts_with("shard.");
}

}  // namespace

RepeatRange ShardPart::repeats_of(std::uint32_t repeats) const {
    if (count > repeats)
        throw input_error("--shard {}: expected at most {} parts, one a repeat", text(), repeats);
    const auto cut = [&](std::uint64_t i) { return static_cast<std::uint32_t>(repeats * i / count); };
    return {cut(index), cut(index + std::uint64_t{1})};
}

std::string ShardPart::text() const { return fmt::format("{}/{}", index, count); }

std::optional<ShardPart> parse_shard_part(const std::string& text) {
    const std::size_t slash = text.find('/');
    if (slash == std::string::npos) return std::nullopt;
    const auto index = whole_number<std::uint32_t>(std::string_view(text).substr(0, slash));
    const auto count = whole_number<std::uint32_t>(std::string_view(text).substr(slash + 1));
    if (!index || !count || *index >= *count) return std::nullopt;
    return ShardPart{*index, *count};
}

std::uint64_t digest_of_input(const Scene& scene, const fs::path& scene_file, const PixelRect& crop) {
    Digest digest;
    for (const int edge : {crop.x0, crop.y0, crop.x1, crop.y1}) digest.add(static_cast<std::uint64_t>(edge));
    add_file(digest, scene_file);
    for (const Surface& surface : scene.surfaces)
        std::visit([&](const auto& shape) { add_file_of(digest, shape); }, surface.shape);
    for (const Volume& volume : scene.volumes)
        if (const auto* const file = std::get_if<fs::path>(&volume.source)) add_file(digest, *file);
    return digest.value();
}

void write_shard(Image image, const Shard& shard, std::uint64_t input_digest, const fs::path& file) {
    const auto set = [&](std::string_view name, std::string value) {
        image.attributes[std::string(name)] = std::move(value);
    };
    set(kPart, shard.part.text());
    set(kRepeats, repeats_text(shard.part.repeats_of(shard.all_repeats), shard.all_repeats));
    set(kNear, fmt::format("{:a}", shard.frame.near));
    set(kExponent, fmt::to_string(shard.frame.exponent));
    set(kUnits, fmt::format("{:a}", shard.sums.units));
    set(kParticles, fmt::to_string(shard.sums.particles));
    set(kInput, fmt::format("{:016x}", input_digest));
    set(kChecksum, checksum(image.width(), image.height(), image.attributes, shard.sums));
    std::vector<WordPlane> planes;
    for_each_plane(shard.sums.pixels.front(), [&](const std::string& name, const std::uint32_t* first) {
        planes.push_back({name, first, sizeof(EnsembleSums::Pixel)});
    });
    write_exr(image, file, planes);
}

ShardHeader read_shard_header(const fs::path& file) {
    ExrHeader exr = read_exr_header(file);
    ShardHeader header{
        .file = file, .width = exr.width, .height = exr.height, .attributes = std::move(exr.attributes)};
    const AttributeReader read(header);
    header.part = read.value(kPart, "i/n with 0 <= i < n", parse_shard_part);
    header.frame.near = read.value(kNear, "an exact number", exact_number);
    header.frame.exponent = read.value(kExponent, "an integer", whole_number<int>);
    header.units = read.value(kUnits, "an exact number", exact_number);
    header.particles = read.value(kParticles, "an integer >= 0", whole_number<std::uint64_t>);
    (void)read.text(kChecksum);

    const std::string& repeats = read.text(kRepeats);
    const auto all = whole_number<std::uint32_t>(std::string_view(repeats).substr(repeats.rfind(' ') + 1));
    if (!all || *all > kMostRepeats || header.part.count > *all)
        throw read.error(
            kRepeats, fmt::format("FIRST to LAST of ALL, {} <= ALL <= {}", header.part.count, kMostRepeats));
    header.all_repeats = *all;
    const std::string expected = repeats_text(header.part.repeats_of(*all), *all);
    if (repeats != expected) throw read.error(kRepeats, expected);
    return header;
}

EnsembleSums read_shard_sums(const ShardHeader& header) {
    EnsembleSums sums(static_cast<std::size_t>(header.width) * static_cast<std::size_t>(header.height),
                      header.units);
    const RepeatRange range = header.part.repeats_of(header.all_repeats);
    sums.repeats = range.end - range.first;
    sums.particles = header.particles;
    std::vector<WordTarget> planes;
    for_each_plane(sums.pixels.front(), [&](const std::string& name, std::uint32_t* first) {
        planes.push_back({name, first, sizeof(EnsembleSums::Pixel)});
    });
    read_exr_words(header.file, header.width, header.height, planes);
    const std::string& stated = header.attributes.at(std::string(kChecksum));
    const std::string found = checksum(header.width, header.height, header.attributes, sums);
    if (found != stated)
        throw input_error("{}: is damaged: {} = {}, but its contents have {}", header.file.string(),
                          kChecksum, one_line(stated, 60), found);
    return sums;
}

Image merge_shards(std::span<const fs::path> files) {
    if (files.empty()) throw input_error("no shard to merge");
    std::vector<ShardHeader> headers;
    headers.reserve(files.size());
    std::set<std::string> devices;
    for (const fs::path& file : files) {
        headers.push_back(read_shard_header(file));
        require_same_image(headers.back(), headers.front());
        const auto device = headers.back().attributes.find(std::string(kDevice));
        if (device != headers.back().attributes.end()) devices.insert(device->second);
    }
    require_each_once(headers);

    const ShardHeader& first = headers.front();
    EnsembleSums sums = read_shard_sums(first);
    for (std::size_t i = 1; i < headers.size(); ++i) sums.add(read_shard_sums(headers[i]));

    Image image(first.width, first.height);
    add_ensemble_planes(first.frame, sums, image);
    for (const auto& [name, value] : first.attributes)
        if (!of_shards_alone(name)) image.attributes[name] = value;
    if (!devices.empty())
        image.attributes[std::string(kDevice)] = fmt::format("{}", fmt::join(devices, " + "));
    return image;
}

}  // namespace pellucid
