// What becomes of zSlabs that meet: arrays of one pixel's ray, merged by the kernel of the method `slabs`. Where they are
// too many, the compression sees the whole array; --streaming: slab by slab, as the method has to.
//   slabs-merge A.csv B.csv…  [--layers N] [--composite] [-o OUT.csv] …
// Columns z,d,r,g,b,a: depth of the back, thickness, associated colour, opacity; a header may name them in another
// order. A file's slabs may lie in any order and overlap: they are inserted one by one.
// Exit 0: fine; 2: bad input; 4: the output could not be written.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include <fmt/format.h>

#include "core/error.hpp"
#include "harness/options.hpp"
#include "io/atomic_file.hpp"
#include "io/file_rows.hpp"
#include "io/input_file.hpp"
#include "stage/slab_compression.hpp"
#include "stage/slab_merge.hpp"

namespace {

using namespace pellucid;
using twin::Slab;

constexpr std::size_t kColumns = 6;
constexpr std::array<std::string_view, kColumns> kNames{"z", "d", "r", "g", "b", "a"};
/// Where the kernel's numbers end; far beyond any scene.
constexpr double kLargest = 1e30;

/// A file with the line that is being read, for messages.
struct Place {
    const std::string& file;
    std::size_t line;
};

// ---- Reading ----------------------------------------------------------------------------------

[[nodiscard]] std::string_view trimmed(std::string_view text) {
    const auto first = text.find_first_not_of(" \t\r");
    if (first == std::string_view::npos) return {};
    return text.substr(first, text.find_last_not_of(" \t\r") - first + 1);
}

[[nodiscard]] std::vector<std::string_view> cells_of(std::string_view line) {
    std::vector<std::string_view> cells;
    for (std::size_t begin = 0; begin <= line.size();) {
        const std::size_t end = std::min(line.find(',', begin), line.size());
        cells.push_back(trimmed(line.substr(begin, end - begin)));
        begin = end + 1;
    }
    return cells;
}

/// Where each of z, d, r, g, b, a stands.
using Columns = std::array<std::size_t, kColumns>;

[[nodiscard]] Columns columns_of(const std::vector<std::string_view>& header, const Place& at) {
    Columns columns{};
    for (const std::string_view name : header) {
        if (std::find(kNames.begin(), kNames.end(), name) == kNames.end())
            throw input_error("{}:{}: column \"{}\", expected z, d, r, g, b and a", at.file, at.line, one_line(name, 40));
        if (std::count(header.begin(), header.end(), name) > 1)
            throw input_error("{}:{}: column \"{}\" twice, expected once", at.file, at.line, name);
    }
    for (std::size_t i = 0; i < kColumns; ++i) {
        const auto found = std::find(header.begin(), header.end(), kNames[i]);
        if (found == header.end())
            throw input_error("{}:{}: no column \"{}\", expected z, d, r, g, b and a", at.file, at.line, kNames[i]);
        columns[i] = static_cast<std::size_t>(found - header.begin());
    }
    return columns;
}

[[nodiscard]] float number(std::string_view cell, std::size_t column, const Place& at) {
    double value = 0;
    const double least = column == 0 ? -kLargest : 0;
    const double most = column == 5 ? 1 : kLargest;
    if (!rows::parse(cell, value) || !(value >= least && value <= most))
        throw input_error("{}:{}: {} = {}, expected a number in [{}, {}]", at.file, at.line, kNames[column],
                          cell.empty() ? "nothing" : one_line(cell, 40), least, most);
    return static_cast<float>(value);
}

[[nodiscard]] Slab slab_of(const std::vector<std::string_view>& cells, const Columns& columns, const Place& at) {
    if (cells.size() != kColumns)
        throw input_error("{}:{}: {} cells, expected {}: z, d, r, g, b and a", at.file, at.line, cells.size(), kColumns);
    std::array<float, kColumns> v{};
    for (std::size_t i = 0; i < kColumns; ++i) v[i] = number(cells[columns[i]], i, at);
    return {v[0], v[1], v[2], v[3], v[4], v[5]};
}

[[nodiscard]] SlabArray read_slabs(const std::string& file) {
    const std::string text = read_input_file(file);
    Columns columns{0, 1, 2, 3, 4, 5};
    SlabArray slabs;
    bool first = true;
    std::size_t line = 0;
    for (std::string_view rest = text; !rest.empty();) {
        const std::size_t end = std::min(rest.find('\n'), rest.size());
        const std::string_view row = trimmed(rest.substr(0, end));
        rest.remove_prefix(std::min(end + 1, rest.size()));
        ++line;
        if (row.empty()) continue;
        const Place at{file, line};
        const auto cells = cells_of(row);
        double ignored = 0;
        const bool header = first && std::none_of(cells.begin(), cells.end(),
                                                  [&](std::string_view cell) { return rows::parse(cell, ignored); });
        first = false;
        if (header) columns = columns_of(cells, at);
        else slabs.push_back(slab_of(cells, columns, at));
    }
    return slabs;
}

// ---- Merging ----------------------------------------------------------------------------------

struct Options {
    std::vector<std::string> files;
    std::optional<std::uint64_t> layers;
    double opaque_at = 2;  // nothing ends a ray
    bool composite = false;
    bool streaming = false;
    std::string output;
    SlabSettings settings;
};

[[nodiscard]] SlabArray fitted(SlabArray slabs, const Options& options) {
    if (!options.layers || slabs.size() < *options.layers) return slabs;
    if (options.streaming) {
        SlabSettings settings = options.settings;
        settings.layers = static_cast<int>(*options.layers);
        SlabCollector collector(settings);
        collector.start();
        for (const Slab& slab : slabs)
            if (!collector.push(slab)) break;
        const auto kept = collector.finish();
        return {kept.begin(), kept.end()};
    }
    return compress_slabs(slabs, *options.layers - 1, options.settings.compression);
}

[[nodiscard]] SlabArray merged(const std::vector<SlabArray>& files, const Options& options) {
    if (options.settings.intermix == SlabIntermix::order_free) {
        const std::vector<std::span<const Slab>> arrays(files.begin(), files.end());
        return fitted(merge_order_free(arrays, options.settings), options);
    }
    SlabArray all;
    for (const SlabArray& file : files) {
        SlabArray array;
        for (const Slab& slab : file) insert_slab(array, slab, options.settings);
        all = fitted(merge_arrays(all, array, options.settings), options);
    }
    return all;
}

[[nodiscard]] std::string csv_of(std::span<const Slab> slabs) {
    std::string text = "z,d,r,g,b,a\n";
    for (const Slab& s : slabs)
        text += fmt::format("{},{},{},{},{},{}\n", s.z, s.d, s.r, s.g, s.b, s.a);  // reads back as the same bits
    return text;
}

void write_csv(const std::string& text, const std::string& file) {
    if (!file.empty()) return write_text_file(file, text);
    if (std::fputs(text.c_str(), stdout) < 0 || std::fflush(stdout) != 0)
        throw run_error("standard output: cannot be written");
}

// ---- Choices ----------------------------------------------------------------------------------

/// A choice whose n-th name is the n-th value of an enum.
template <class Enum>
void add_choice(Arguments& arguments, const std::string& name, const std::vector<std::string>& names, Enum& value,
                const std::string& help) {
    arguments.choice(name, names, [&value, names](const std::string& chosen) {
        value = static_cast<Enum>(std::find(names.begin(), names.end(), chosen) - names.begin());
    }, help);
}

}  // namespace

int main(int argc, char** argv) {
    return guarded_main("slabs-merge", [&] {
        Options options;
        SlabSettings& settings = options.settings;
        Arguments arguments("slabs-merge", "Merges arrays of zSlabs of one ray: columns z,d,r,g,b,a, associated colour.");
        arguments.positionals("FILE", options.files, "CSV files, merged in this order");
        arguments.option("--layers", options.layers, "keep at most N - 1 slabs (default: all)");
        add_choice(arguments, "--interpolation", {"modified", "original", "original-textbook"}, settings.interpolation,
                   "opacity inside of a slab that is cut (default modified)");
        add_choice(arguments, "--mixing", {"average", "normalised", "extinction"}, settings.mixing,
                   "slabs of one interval (default average)");
        add_choice(arguments, "--intermix", {"image", "hybrid", "order-free"}, settings.intermix,
                   "arrays one by one, the same, or all at once (default image)");
        add_choice(arguments, "--compression", {"tail", "slope", "transmittance"}, settings.compression,
                   "which slabs merge where they are too many (default transmittance)");
        arguments.option("--opaque-at", options.opaque_at, "leave out what lies behind this opacity (default: nothing)");
        arguments.flag("--streaming", options.streaming, "compress slab by slab, as the method `slabs`");
        arguments.flag("--composite", options.composite, "print all slabs composited to one");
        arguments.option("-o,--output", options.output, "CSV file (default: standard output)");
        if (!arguments.parse(argc, argv)) return 0;
        if (options.layers && (*options.layers < 2 || *options.layers > 4096))
            throw input_error("--layers = {}, expected 2 to 4096", *options.layers);
        if (!(options.opaque_at > 0)) throw input_error("--opaque-at = {}, expected a number above 0", options.opaque_at);
        settings.opaque_at = static_cast<float>(options.opaque_at);

        std::vector<SlabArray> files;
        for (const std::string& file : options.files) files.push_back(read_slabs(file));
        SlabArray slabs = merged(files, options);
        if (options.composite) slabs = {composite(slabs)};
        write_csv(csv_of(slabs), options.output);
        return 0;
    });
}
