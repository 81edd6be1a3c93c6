// Strict reading of TOML: scenes and experiment settings.
//
// A `Config` is a parsed document that knows where each value came from; a `ConfigTable` is a view
// of one of its tables whose getters check type and range, and remember what was asked for. What
// nobody asked for is a misspelt key, so `Config::finish` refuses it; what was asked for, defaults
// included, is the resolved configuration that `Config::to_json` writes down.
//
// Every failure is Error(input), one line that names place, thing, value and expectation:
//   scene.toml:12: surface "ring": opacity = 1.5, expected [0, 1]
//   --set camera.fov_degrees: camera.fov_degrees = "wide" is a string, expected a number
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <initializer_list>
#include <limits>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "core/error.hpp"
#include "core/vec.hpp"

namespace pellucid {

/// In place of a default: the key must be there.
inline constexpr std::nullopt_t kRequired = std::nullopt;

/// Which numbers a key takes. NaN is never in a range; infinities only if `infinite` is set.
struct Range {
    double lo = -kInfinity;
    double hi = kInfinity;
    bool lo_open = false;
    bool hi_open = false;
    bool infinite = false;

    [[nodiscard]] bool contains(double x) const;
    [[nodiscard]] std::string text() const;  // "[0, 1)", "> 0", "a finite number"
};
[[nodiscard]] constexpr Range within(double lo, double hi) {
    return {.lo = lo, .hi = hi};
}
[[nodiscard]] constexpr Range strictly_within(double lo, double hi) {
    return {.lo = lo, .hi = hi, .lo_open = true, .hi_open = true};
}
[[nodiscard]] constexpr Range at_least(double lo) {
    return {.lo = lo};
}
[[nodiscard]] constexpr Range above(double lo) {
    return {.lo = lo, .lo_open = true};
}

struct IntegerRange {
    std::int64_t lo = std::numeric_limits<std::int64_t>::min();
    std::int64_t hi = std::numeric_limits<std::int64_t>::max();
};

/// How many elements a list takes.
struct Count {
    std::size_t min = 1;
    std::size_t max = std::numeric_limits<std::size_t>::max();
};
[[nodiscard]] constexpr Count exactly(std::size_t n) {
    return {n, n};
}

enum class ValueKind { absent, boolean, integer, number, string, date, array, table };

struct ConfigNode;
struct ConfigDocument;

/// One table of a document, or one that is absent: then every getter returns its default. Each
/// getter takes a default, or kRequired. Valid as long as any copy of the document is; overrides
/// and presets must be applied before the first view is made.
class ConfigTable {
public:
    /// True where the key is there. Counts as asking for it.
    [[nodiscard]] bool has(std::string_view key) const { return kind(key) != ValueKind::absent; }
    [[nodiscard]] ValueKind kind(std::string_view key) const;
    /// False where the whole table is absent.
    [[nodiscard]] bool present() const { return node_ != nullptr; }
    /// What messages call this table: `surface "ring"`, `camera`.
    [[nodiscard]] std::string title() const;

    bool boolean(std::string_view key, std::optional<bool> fallback) const;
    /// Integers are numbers too.
    double number(std::string_view key, std::optional<double> fallback, const Range& range = {}) const;
    /// A number that may be absent without a default.
    std::optional<double> number_if(std::string_view key, const Range& range = {}) const;
    std::int64_t integer(std::string_view key, std::optional<std::int64_t> fallback,
                         const IntegerRange& range = {}) const;
    std::string text(std::string_view key, std::optional<std::string> fallback) const;
    Vec3 vec3(std::string_view key, std::optional<Vec3> fallback, const Range& range = {}) const;

    /// Lists. One value alone is a list of one.
    std::vector<double> numbers(std::string_view key, std::optional<std::vector<double>> fallback,
                                const Range& range = {}, const Count& count = {}) const;
    std::vector<std::int64_t> integers(std::string_view key,
                                       std::optional<std::vector<std::int64_t>> fallback,
                                       const IntegerRange& range = {}, const Count& count = {}) const;
    std::vector<std::string> texts(std::string_view key, std::optional<std::vector<std::string>> fallback,
                                   const Count& count = {}) const;
    /// A required list of lists of `columns` finite numbers each.
    std::vector<std::vector<double>> rows(std::string_view key, std::size_t columns,
                                          const Count& count = {}) const;
    /// A sub-table of numbers under free names; empty where absent.
    std::map<std::string, double> number_map(std::string_view key) const;

    /// One of `names`.
    std::string one_of(std::string_view key, std::optional<std::string> fallback,
                       std::span<const std::string> names) const;
    std::string one_of(std::string_view key, std::optional<std::string> fallback,
                       std::initializer_list<std::string> names) const {
        return one_of(key, std::move(fallback), std::span<const std::string>(names.begin(), names.size()));
    }
    /// The enumerator of the given name. `fallback` must be among the choices.
    template <class Enum>
    Enum choice(std::string_view key, std::optional<Enum> fallback,
                std::initializer_list<std::pair<std::string, Enum>> choices) const {
        std::vector<std::string> names;
        std::optional<std::string> fallback_name;
        for (const auto& [name, value] : choices) {
            names.push_back(name);
            if (fallback && value == *fallback) fallback_name = name;
        }
        const std::string found = one_of(key, fallback_name, names);
        for (const auto& [name, value] : choices)
            if (name == found) return value;
        return choices.begin()->second;  // not reached: one_of returned one of the names
    }

    /// A path, taken from beside the document unless absolute. Whether it exists is the reader's matter.
    std::filesystem::path file(std::string_view key) const;

    /// A sub-table, absent or not; of required ones ask `present()` or read a required key.
    ConfigTable table(std::string_view key) const;
    /// An array of tables; empty where absent. Those with a `name` are called by it in messages.
    std::vector<ConfigTable> tables(std::string_view key) const;

    /// An error at the place of `key` (of the table where it is absent):
    /// `scene.toml:7: camera.up ` + `problem`. An empty key names the table.
    [[nodiscard]] Error error(std::string_view key, std::string_view problem) const;

private:
    friend class Config;
    struct PathPart {
        std::string key;
        std::optional<std::size_t> index;
    };
    ConfigTable(std::shared_ptr<ConfigDocument> document, const ConfigNode* node)
        : document_(std::move(document)), node_(node) {}
    [[nodiscard]] const ConfigNode* find(std::string_view key) const;
    [[nodiscard]] const ConfigNode* need(std::string_view key, std::string_view expected,
                                         bool has_fallback) const;
    [[nodiscard]] Error wrong_type(std::string_view key, const ConfigNode& node,
                                   std::string_view expected) const;
    [[nodiscard]] Error wrong_value(std::string_view key, const std::string& value,
                                    std::string_view expected) const;
    [[nodiscard]] std::string name_of(std::string_view key) const;
    [[nodiscard]] std::string asked_path() const;
    double checked_number(std::string_view key, const ConfigNode& node, const Range& range) const;
    std::int64_t checked_integer(std::string_view key, const ConfigNode& node,
                                 const IntegerRange& range) const;
    template <class T, class Read>
    std::vector<T> list(std::string_view key, const std::vector<T>* fallback, std::string_view expected,
                        const Count& count, const Read& read) const;
    template <class T>
    T recorded(std::string_view key, T value) const;

    std::shared_ptr<ConfigDocument> document_;
    const ConfigNode* node_ = nullptr;
    const ConfigNode* nearest_ = nullptr;  // the innermost table that is there: gives the place
    std::vector<PathPart> path_;
    std::string label_;   // `surface "ring"`, or empty
    std::string prefix_;  // "camera.", "shading.": what stands before a key in messages
};

class Config {
public:
    /// Reads a TOML file of at most 64 MiB.
    [[nodiscard]] static Config read(const std::filesystem::path& file);
    /// Parses `toml`; messages call it `source`; files are looked up in `directory`.
    [[nodiscard]] static Config parse(std::string_view toml, const std::string& source,
                                      const std::filesystem::path& directory = {});

    /// Takes the tables `names` out of the document and lays the one called `chosen` over it: its
    /// keys replace those of the same name, its sub-tables are merged. `chosen` need not be there.
    /// `finish` checks the keys of the others, too.
    void apply_preset(std::string_view chosen, std::span<const std::string> names);

    /// `key.path=VALUE`, VALUE as in TOML; a plain word is a string. Elements of arrays are named by
    /// index or by their `name`: `surface.0.opacity=0.5`, `surface.ring.opacity=0.5`. Tables that are
    /// not there are made. Keys the reader never asks for fail in `finish`, as `--set key.path`.
    void apply_override(std::string_view assignment);

    /// True where the document has this top-level key. Does not count as asking for it.
    [[nodiscard]] bool holds(std::string_view key) const;
    [[nodiscard]] ConfigTable root() const;
    /// Throws for the first key that no getter asked for, with the nearest one that was.
    void finish() const;
    /// All that was read, with the defaults that were taken, as indented JSON.
    [[nodiscard]] std::string to_json() const;
    /// The file as given, or the `source` of parse.
    [[nodiscard]] const std::string& source() const;

private:
    explicit Config(std::shared_ptr<ConfigDocument> document) : document_(std::move(document)) {}
    std::shared_ptr<ConfigDocument> document_;
};

/// Of `known`, the name most like `name` (at most a third of its letters differ).
[[nodiscard]] std::optional<std::string> nearest_name(std::string_view name,
                                                      std::span<const std::string> known);

}  // namespace pellucid
