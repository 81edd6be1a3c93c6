#include "io/config.hpp"

#include <algorithm>
#include <cmath>
#include <fstream>
#include <set>
#include <sstream>

#include <fmt/format.h>
#include <toml++/toml.h>
#include <nlohmann/json.hpp>

namespace pellucid {

using Json = nlohmann::ordered_json;

/// Where a value came from: `scene.toml:12`, `--set camera.position`.
struct Place {
    std::shared_ptr<const std::string> origin;
    unsigned line = 0;  // 0: the origin has no lines

    [[nodiscard]] std::string text() const {
        return line > 0 ? fmt::format("{}:{}", *origin, line) : *origin;
    }
};

/// A TOML value with its place. A copy of what toml++ parsed, because documents are merged here and
/// nodes of toml++ lose their line when they are copied.
struct ConfigNode {
    ValueKind kind = ValueKind::table;
    Place place;
    bool boolean = false;
    std::int64_t integer = 0;
    double number = 0;  // of integers, too
    std::string string;
    std::vector<std::string> keys;  // of a table: keys[i] names items[i]
    std::vector<ConfigNode> items;  // of a table or array

    [[nodiscard]] const ConfigNode* find(std::string_view key) const {
        if (kind != ValueKind::table) return nullptr;
        const auto at = std::find(keys.begin(), keys.end(), key);
        return at == keys.end() ? nullptr : &items[static_cast<std::size_t>(at - keys.begin())];
    }
    [[nodiscard]] ConfigNode* find(std::string_view key) {
        return const_cast<ConfigNode*>(std::as_const(*this).find(key));
    }
    ConfigNode& set(std::string_view key, ConfigNode value) {
        if (ConfigNode* old = find(key)) return *old = std::move(value);
        keys.emplace_back(key);
        return items.emplace_back(std::move(value));
    }
    std::optional<ConfigNode> take(std::string_view key) {
        const auto at = std::find(keys.begin(), keys.end(), key);
        if (at == keys.end()) return std::nullopt;
        const auto item = items.begin() + (at - keys.begin());
        ConfigNode out = std::move(*item);
        items.erase(item);
        keys.erase(at);
        return out;
    }
};

struct ConfigDocument {
    std::string source;
    std::filesystem::path directory;
    ConfigNode root;
    std::vector<ConfigNode> other_presets;               // not chosen; only their keys are checked
    std::map<std::string, std::set<std::string>> asked;  // path of a table -> keys asked for
    std::set<std::string> asked_whole;                   // paths whose contents are all used
    Json resolved = Json::object();
};

namespace {

constexpr std::uintmax_t kMaxFileBytes = 64U << 20;
// Documents are walked recursively: a limit on the depth is a limit on the stack. No scene or
// configuration here is deeper than six.
constexpr int kMaxDepth = 64;
constexpr int kMaxDotsInKey = 32;
constexpr char kPathSeparator = '\x1f';

std::string joined(const std::string& path, std::string_view key) {
    return path + kPathSeparator + std::string(key);
}

std::string in_quotes(std::string_view text, std::size_t limit = 60) {
    return '"' + one_line(text, limit) + '"';
}

std::string_view kind_name(ValueKind kind) {
    switch (kind) {
        case ValueKind::absent:
            return "nothing";
        case ValueKind::boolean:
            return "a boolean";
        case ValueKind::integer:
            return "an integer";
        case ValueKind::number:
            return "a number";
        case ValueKind::string:
            return "a string";
        case ValueKind::date:
            return "a date";
        case ValueKind::array:
            return "a list";
        case ValueKind::table:
            return "a table";
    }
    return "?";
}

/// A value as it stands in messages.
std::string shown(const ConfigNode& node) {
    switch (node.kind) {
        case ValueKind::boolean:
            return node.boolean ? "true" : "false";
        case ValueKind::integer:
            return std::to_string(node.integer);
        case ValueKind::number:
            return fmt::format("{}", node.number);
        case ValueKind::string:
            return in_quotes(node.string);
        case ValueKind::date:
            return node.string;
        case ValueKind::array: {
            std::string out = "[";
            for (const ConfigNode& item : node.items) {
                if (out.size() > 1) out += ", ";
                if (out.size() > 50) return out + "…]";
                out += shown(item);
            }
            return out + "]";
        }
        default:
            return "{…}";
    }
}

// ---- parsing

ConfigNode converted(const toml::node& from, const std::shared_ptr<const std::string>& origin, bool lines,
                     int depth) {
    ConfigNode to;
    to.place = {origin, lines ? static_cast<unsigned>(from.source().begin.line) : 0U};
    if (depth > kMaxDepth) throw input_error("{}: nested deeper than {}", to.place.text(), kMaxDepth);
    if (const toml::table* table = from.as_table()) {
        to.kind = ValueKind::table;
        std::vector<std::pair<std::string, const toml::node*>> entries;
        for (auto&& [key, value] : *table) entries.emplace_back(std::string(key.str()), &value);
        // In the order of the file, as far as toml++ knows it.
        std::stable_sort(entries.begin(), entries.end(), [](const auto& a, const auto& b) {
            return a.second->source().begin < b.second->source().begin;
        });
        for (const auto& [key, value] : entries) {
            to.keys.push_back(key);
            to.items.push_back(converted(*value, origin, lines, depth + 1));
        }
    } else if (const toml::array* array = from.as_array()) {
        to.kind = ValueKind::array;
        to.items.reserve(array->size());
        for (const toml::node& item : *array) to.items.push_back(converted(item, origin, lines, depth + 1));
    } else if (const auto* boolean = from.as_boolean()) {
        to.kind = ValueKind::boolean;
        to.boolean = boolean->get();
    } else if (const auto* integer = from.as_integer()) {
        to.kind = ValueKind::integer;
        to.integer = integer->get();
        to.number = static_cast<double>(to.integer);
    } else if (const auto* number = from.as_floating_point()) {
        to.kind = ValueKind::number;
        to.number = number->get();
    } else if (const auto* string = from.as_string()) {
        to.kind = ValueKind::string;
        to.string = string->get();
    } else {
        to.kind = ValueKind::date;
        std::ostringstream out;
        from.visit([&out](const auto& value) {
            if constexpr (toml::is_date<decltype(value)> || toml::is_time<decltype(value)> ||
                          toml::is_date_time<decltype(value)>)
                out << value.get();
        });
        to.string = out.str();
    }
    return to;
}

/// toml++ bounds the depth of values but not the length of dotted keys, whose tables it destroys
/// recursively; so very long ones are refused before it sees them. Quoted parts count as one letter.
void refuse_long_keys(std::string_view toml, const std::string& source) {
    int dots = 0;
    unsigned line = 1;
    for (std::size_t i = 0; i < toml.size(); ++i) {
        const char c = toml[i];
        if (c == '\n') ++line;
        if (c == '"' || c == '\'') {
            const std::size_t close = toml.find_first_of(c == '"' ? "\"\n" : "'\n", i + 1);
            if (close != std::string_view::npos && toml[close] == c) i = close;
        } else if (c == '.') {
            if (++dots > kMaxDotsInKey)
                throw input_error("{}:{}: a key of more than {} parts", source, line, kMaxDotsInKey);
        } else if (std::string_view("\n,={}[]#").find(c) != std::string_view::npos) {
            dots = 0;
        }
    }
}

ConfigNode parsed(std::string_view toml, const std::string& source, bool lines) {
    refuse_long_keys(toml, source);
    try {
        const toml::table table = toml::parse(toml);
        return converted(table, std::make_shared<const std::string>(source), lines, 0);
    } catch (const toml::parse_error& e) {
        throw input_error("{}:{}: {}", source, e.source().begin.line, one_line(e.description()));
    }
}

// ---- overrides

/// The parts of `surface."outer ring".opacity`.
std::vector<std::string> split_path(std::string_view path, const std::string& origin) {
    std::vector<std::string> parts;
    std::size_t i = 0;
    while (true) {
        std::string part;
        if (i < path.size() && (path[i] == '"' || path[i] == '\'')) {
            const std::size_t close = path.find(path[i], i + 1);
            if (close == std::string_view::npos) throw input_error("{}: a quote is not closed", origin);
            part = path.substr(i + 1, close - i - 1);
            i = close + 1;
            if (i < path.size() && path[i] != '.')
                throw input_error("{}: expected \".\" after a quote", origin);
        } else {
            const std::size_t dot = std::min(path.find('.', i), path.size());
            part = path.substr(i, dot - i);
            i = dot;
            if (part.empty()) throw input_error("{}: empty key, expected KEY.PATH=VALUE", origin);
        }
        parts.push_back(std::move(part));
        if (static_cast<int>(parts.size()) > kMaxDotsInKey)
            throw input_error("{}: a key of more than {} parts", origin, kMaxDotsInKey);
        if (i >= path.size()) return parts;
        ++i;
    }
}

bool is_plain_word(std::string_view text) {
    return !text.empty() && std::all_of(text.begin(), text.end(), [](unsigned char c) {
        return std::isalnum(c) != 0 || c == '_' || c == '-' || c == '.' || c == '/' || c == '+' || c >= 0x80;
    });
}

/// The value of `--set`: TOML, or a plain word. The TOML parser is also given "a = 1\nb = 2", which
/// is two values; that is why the table is counted.
ConfigNode override_value(const std::string& value, const std::string& origin) {
    try {
        ConfigNode document = parsed("v = " + value, origin, false);
        if (document.items.size() == 1 && document.keys[0] == "v" && value.find('\n') == std::string::npos)
            return std::move(document.items[0]);
    } catch (const Error&) {
        if (is_plain_word(value)) {
            ConfigNode word;
            word.kind = ValueKind::string;
            word.place = {std::make_shared<const std::string>(origin), 0};
            word.string = value;
            return word;
        }
    }
    throw input_error("{} = {}: not a TOML value", origin, one_line(value, 60));
}

/// The element of an array that `part` names: an index, or the `name` of a table.
ConfigNode& element(ConfigNode& array, const std::string& part, const std::string& parent,
                    const std::string& origin) {
    std::vector<std::string> names;
    for (ConfigNode& item : array.items)
        if (const ConfigNode* name = item.find("name"); name != nullptr && name->kind == ValueKind::string) {
            if (name->string == part) return item;
            names.push_back(name->string);
        }
    if (std::all_of(part.begin(), part.end(), [](unsigned char c) { return std::isdigit(c) != 0; }) &&
        !part.empty() && part.size() < 10) {
        const std::size_t index = std::stoul(part);
        if (index < array.items.size()) return array.items[index];
    }
    std::string there = fmt::format("{} element{}", array.items.size(), array.items.size() == 1 ? "" : "s");
    for (std::size_t i = 0; i < names.size(); ++i) there += (i == 0 ? ": " : ", ") + in_quotes(names[i], 40);
    throw input_error("{}: no {} called {} ({})", origin, parent, in_quotes(part), one_line(there, 200));
}

void merge(ConfigNode& into, ConfigNode&& from) {
    for (std::size_t i = 0; i < from.items.size(); ++i) {
        ConfigNode* old = into.find(from.keys[i]);
        if (old != nullptr && old->kind == ValueKind::table && from.items[i].kind == ValueKind::table)
            merge(*old, std::move(from.items[i]));
        else
            into.set(from.keys[i], std::move(from.items[i]));
    }
}

// ---- what was not asked for

void refuse_unknown(const ConfigDocument& document, const ConfigNode& node, const std::string& path,
                    const std::string& name) {
    if (document.asked_whole.contains(path)) return;
    if (node.kind == ValueKind::array) {
        for (std::size_t i = 0; i < node.items.size(); ++i)
            refuse_unknown(document, node.items[i], joined(path, std::to_string(i)),
                           fmt::format("{}[{}]", name, i));
        return;
    }
    if (node.kind != ValueKind::table) return;
    const auto at = document.asked.find(path);
    const std::set<std::string> asked = at == document.asked.end() ? std::set<std::string>{} : at->second;
    for (std::size_t i = 0; i < node.items.size(); ++i) {
        const std::string& key = node.keys[i];
        if (!asked.contains(key)) {
            const std::vector<std::string> known(asked.begin(), asked.end());
            const std::optional<std::string> nearest = nearest_name(key, known);
            throw input_error("{}: {}{}unknown key {}{}", node.items[i].place.text(), name,
                              name.empty() ? "" : ": ", in_quotes(key),
                              nearest ? fmt::format(", did you mean {}?", in_quotes(*nearest)) : "");
        }
        refuse_unknown(document, node.items[i], joined(path, key),
                       name.empty() ? key : fmt::format("{}.{}", name, key));
    }
}

}  // namespace

// ---- small things

bool Range::contains(double x) const {
    if (std::isnan(x)) return false;
    if (std::isinf(x) && !infinite) return false;
    return (lo_open ? x > lo : x >= lo) && (hi_open ? x < hi : x <= hi);
}

std::string Range::text() const {
    const bool has_lo = lo > -kInfinity;
    const bool has_hi = hi < kInfinity;
    if (has_lo && has_hi) return fmt::format("{}{}, {}{}", lo_open ? '(' : '[', lo, hi, hi_open ? ')' : ']');
    if (has_lo) return fmt::format("{} {}", lo_open ? ">" : ">=", lo);
    if (has_hi) return fmt::format("{} {}", hi_open ? "<" : "<=", hi);
    return infinite ? "a number" : "a finite number";
}

std::optional<std::string> nearest_name(std::string_view name, std::span<const std::string> known) {
    std::optional<std::string> best;
    std::size_t best_distance = name.size() / 3 + 1;  // exclusive; a swap counts once, so "opcaity" is near
    if (name.size() > 64) return best;
    for (const std::string& candidate : known) {
        // Optimal string alignment distance, three rows.
        const std::size_t n = candidate.size();
        std::vector<std::size_t> before(n + 1);
        std::vector<std::size_t> last(n + 1);
        std::vector<std::size_t> row(n + 1);
        for (std::size_t j = 0; j <= n; ++j) row[j] = j;
        for (std::size_t i = 1; i <= name.size(); ++i) {
            before = last;
            last = row;
            row[0] = i;
            for (std::size_t j = 1; j <= n; ++j) {
                const bool same = name[i - 1] == candidate[j - 1];
                row[j] = std::min({last[j] + 1, row[j - 1] + 1, last[j - 1] + (same ? 0U : 1U)});
                if (i > 1 && j > 1 && name[i - 1] == candidate[j - 2] && name[i - 2] == candidate[j - 1])
                    row[j] = std::min(row[j], before[j - 2] + 1);
            }
        }
        if (row[n] < best_distance) {
            best_distance = row[n];
            best = candidate;
        }
    }
    return best;
}

// ---- Config

Config Config::parse(std::string_view toml, const std::string& source,
                     const std::filesystem::path& directory) {
    auto document = std::make_shared<ConfigDocument>();
    document->source = source;
    document->directory = directory;
    document->root = parsed(toml, source, true);
    document->root.place.line = 0;
    return Config(std::move(document));
}

Config Config::read(const std::filesystem::path& file) {
    const std::string source = one_line(file.string());
    std::error_code failure;
    const auto status = std::filesystem::status(file, failure);
    if (!std::filesystem::exists(status)) throw input_error("{}: no such file", source);
    if (!std::filesystem::is_regular_file(status)) throw input_error("{}: not a file", source);
    const std::uintmax_t bytes = std::filesystem::file_size(file, failure);
    if (failure) throw input_error("{}: cannot be read ({})", source, failure.message());
    if (bytes > kMaxFileBytes)
        throw input_error("{}: {} bytes, expected at most {}", source, bytes, kMaxFileBytes);
    std::ifstream in(file, std::ios::binary);
    std::string text(static_cast<std::size_t>(bytes), '\0');
    if (!in || (bytes > 0 && !in.read(text.data(), static_cast<std::streamsize>(bytes))))
        throw input_error("{}: cannot be read", source);
    return parse(text, source, file.parent_path());
}

void Config::apply_preset(std::string_view chosen, std::span<const std::string> names) {
    for (const std::string& name : names) {
        std::optional<ConfigNode> preset = document_->root.take(name);
        if (!preset) continue;
        if (preset->kind != ValueKind::table)
            throw input_error("{}: {} is {}, expected the table of a preset", preset->place.text(), name,
                              kind_name(preset->kind));
        if (name == chosen)
            merge(document_->root, std::move(*preset));
        else
            document_->other_presets.push_back(std::move(*preset));
    }
}

void Config::apply_override(std::string_view assignment) {
    const std::size_t equals = assignment.find('=');
    if (equals == std::string_view::npos || equals == 0)
        throw input_error("--set {}: expected KEY=VALUE", one_line(assignment, 100));
    const auto trimmed = [](std::string_view s) {
        while (!s.empty() && (s.front() == ' ' || s.front() == '\t')) s.remove_prefix(1);
        while (!s.empty() && (s.back() == ' ' || s.back() == '\t')) s.remove_suffix(1);
        return std::string(s);
    };
    const std::string key = trimmed(assignment.substr(0, equals));
    const std::string origin = "--set " + one_line(key, 200);
    const std::vector<std::string> parts = split_path(key, origin);
    ConfigNode value = override_value(trimmed(assignment.substr(equals + 1)), origin);

    ConfigNode* node = &document_->root;
    std::string walked = document_->source;
    for (std::size_t i = 0; i < parts.size(); ++i) {
        const bool last = i + 1 == parts.size();
        if (node->kind == ValueKind::array) {
            ConfigNode& item = element(*node, parts[i], walked, origin);
            if (last) item = std::move(value);
            node = &item;
        } else if (node->kind == ValueKind::table) {
            if (last) {
                node->set(parts[i], std::move(value));
                return;
            }
            ConfigNode* child = node->find(parts[i]);
            if (child == nullptr) {
                ConfigNode made;
                made.place = {std::make_shared<const std::string>(origin), 0};
                child = &node->set(parts[i], std::move(made));
            }
            node = child;
        } else {
            throw input_error("{}: {} is {}, not a table", origin, walked, kind_name(node->kind));
        }
        walked = i == 0 ? parts[i] : walked + "." + parts[i];
    }
}

bool Config::holds(std::string_view key) const {
    return document_->root.find(key) != nullptr;
}

ConfigTable Config::root() const {
    ConfigTable table(document_, &document_->root);
    table.nearest_ = &document_->root;
    return table;
}

void Config::finish() const {
    refuse_unknown(*document_, document_->root, {}, {});
    for (const ConfigNode& preset : document_->other_presets) refuse_unknown(*document_, preset, {}, {});
}

std::string Config::to_json() const {
    return document_->resolved.dump(2, ' ', false, Json::error_handler_t::replace);
}

const std::string& Config::source() const {
    return document_->source;
}

// ---- ConfigTable

std::string ConfigTable::asked_path() const {
    std::string path;
    for (const PathPart& part : path_)
        path = joined(path, part.index ? std::to_string(*part.index) : part.key);
    return path;
}

const ConfigNode* ConfigTable::find(std::string_view key) const {
    document_->asked[asked_path()].emplace(key);
    return node_ == nullptr ? nullptr : node_->find(key);
}

std::string ConfigTable::name_of(std::string_view key) const {
    std::string name = prefix_ + std::string(key);
    if (key.empty() && !prefix_.empty()) name.pop_back();  // the dot
    if (label_.empty()) return name;
    return name.empty() ? label_ : label_ + ": " + name;
}

std::string ConfigTable::title() const {
    return name_of("");
}

Error ConfigTable::error(std::string_view key, std::string_view problem) const {
    const ConfigNode* node = node_ == nullptr || key.empty() ? nullptr : node_->find(key);
    const std::string name = name_of(key);
    return input_error("{}: {}{}{}", (node != nullptr ? node : nearest_)->place.text(), name,
                       name.empty() ? "" : " ", problem);
}

Error ConfigTable::wrong_type(std::string_view key, const ConfigNode& node, std::string_view expected) const {
    return error(key, node.kind == ValueKind::table ? fmt::format("is a table, expected {}", expected)
                                                    : fmt::format("= {} is {}, expected {}", shown(node),
                                                                  kind_name(node.kind), expected));
}

Error ConfigTable::wrong_value(std::string_view key, const std::string& value,
                               std::string_view expected) const {
    return error(key, fmt::format("= {}, expected {}", value, expected));
}

/// The node, or null where it is absent and there is a default.
const ConfigNode* ConfigTable::need(std::string_view key, std::string_view expected,
                                    bool has_fallback) const {
    const ConfigNode* node = find(key);
    if (node == nullptr && !has_fallback) throw error(key, fmt::format("is missing, expected {}", expected));
    return node;
}

namespace {
template <class T>
Json json_of(const T& value) {
    return Json(value);
}
Json json_of(double v) {
    return std::isfinite(v) ? Json(v) : Json(fmt::format("{}", v));
}
template <class T>
Json json_of(const std::vector<T>& values) {
    Json list = Json::array();
    for (const T& value : values) list.push_back(json_of(value));
    return list;
}
}  // namespace

template <class T>
T ConfigTable::recorded(std::string_view key, T value) const {
    Json* at = &document_->resolved;
    for (const PathPart& part : path_) {
        if (part.index) {
            if (!at->is_array()) *at = Json::array();
            while (at->size() <= *part.index) at->push_back(Json::object());
            at = &(*at)[*part.index];
        } else {
            at = &(*at)[part.key];
        }
        if (at->is_null()) *at = Json::object();
    }
    // Asked for twice, in two shapes ("flat" or a table): the last one holds.
    if (!at->is_object()) *at = Json::object();
    (*at)[std::string(key)] = json_of(value);
    return value;
}

ValueKind ConfigTable::kind(std::string_view key) const {
    const ConfigNode* node = find(key);
    return node == nullptr ? ValueKind::absent : node->kind;
}

bool ConfigTable::boolean(std::string_view key, std::optional<bool> fallback) const {
    const ConfigNode* node = need(key, "true or false", fallback.has_value());
    if (node == nullptr) return recorded(key, *fallback);
    if (node->kind != ValueKind::boolean) throw wrong_type(key, *node, "true or false");
    return recorded(key, node->boolean);
}

double ConfigTable::checked_number(std::string_view key, const ConfigNode& node, const Range& range) const {
    if (node.kind != ValueKind::number && node.kind != ValueKind::integer)
        throw wrong_type(key, node, "a number");
    if (!range.contains(node.number)) {
        // "-inf, expected >= 0" says it all; "inf, expected >= 0" does not.
        const bool silent = std::isinf(node.number) && node.number >= range.lo && node.number <= range.hi;
        throw wrong_value(key, shown(node), silent ? "a finite number" : range.text());
    }
    return node.number;
}

double ConfigTable::number(std::string_view key, std::optional<double> fallback, const Range& range) const {
    const ConfigNode* node = need(key, "a number", fallback.has_value());
    return recorded(key, node == nullptr ? *fallback : checked_number(key, *node, range));
}

std::optional<double> ConfigTable::number_if(std::string_view key, const Range& range) const {
    if (!has(key)) return std::nullopt;
    return number(key, kRequired, range);
}

std::int64_t ConfigTable::checked_integer(std::string_view key, const ConfigNode& node,
                                          const IntegerRange& range) const {
    if (node.kind != ValueKind::integer) throw wrong_type(key, node, "an integer");
    if (node.integer < range.lo || node.integer > range.hi) {
        const IntegerRange all;
        const std::string expected = range.hi == all.hi   ? fmt::format(">= {}", range.lo)
                                     : range.lo == all.lo ? fmt::format("<= {}", range.hi)
                                                          : fmt::format("[{}, {}]", range.lo, range.hi);
        throw wrong_value(key, shown(node), expected);
    }
    return node.integer;
}

std::int64_t ConfigTable::integer(std::string_view key, std::optional<std::int64_t> fallback,
                                  const IntegerRange& range) const {
    const ConfigNode* node = need(key, "an integer", fallback.has_value());
    return recorded(key, node == nullptr ? *fallback : checked_integer(key, *node, range));
}

std::string ConfigTable::text(std::string_view key, std::optional<std::string> fallback) const {
    const ConfigNode* node = need(key, "a string", fallback.has_value());
    if (node == nullptr) return recorded(key, *fallback);
    if (node->kind != ValueKind::string) throw wrong_type(key, *node, "a string");
    return recorded(key, node->string);
}

template <class T, class Read>
std::vector<T> ConfigTable::list(std::string_view key, const std::vector<T>* fallback,
                                 std::string_view expected, const Count& count, const Read& read) const {
    const ConfigNode* node = need(key, expected, fallback != nullptr);
    if (node == nullptr) return recorded(key, *fallback);
    std::vector<T> values;
    if (node->kind == ValueKind::array) {
        if (node->items.size() < count.min || node->items.size() > count.max) {
            const std::string wanted = count.min == count.max ? std::to_string(count.min)
                                       : node->items.size() < count.min
                                           ? fmt::format("at least {}", count.min)
                                           : fmt::format("at most {}", count.max);
            throw error(key, fmt::format("has {} element{}, expected {}", node->items.size(),
                                         node->items.size() == 1 ? "" : "s", wanted));
        }
        values.reserve(node->items.size());
        for (const ConfigNode& item : node->items) values.push_back(read(item));
    } else {
        if (count.min > 1) throw wrong_type(key, *node, expected);
        values.push_back(read(*node));
    }
    document_->asked_whole.insert(joined(asked_path(), key));
    return recorded(key, std::move(values));
}

std::vector<double> ConfigTable::numbers(std::string_view key, std::optional<std::vector<double>> fallback,
                                         const Range& range, const Count& count) const {
    return list(key, fallback ? &*fallback : nullptr, "a list of numbers", count,
                [&](const ConfigNode& item) { return checked_number(key, item, range); });
}

std::vector<std::int64_t> ConfigTable::integers(std::string_view key,
                                                std::optional<std::vector<std::int64_t>> fallback,
                                                const IntegerRange& range, const Count& count) const {
    return list(key, fallback ? &*fallback : nullptr, "a list of integers", count,
                [&](const ConfigNode& item) { return checked_integer(key, item, range); });
}

std::vector<std::string> ConfigTable::texts(std::string_view key,
                                            std::optional<std::vector<std::string>> fallback,
                                            const Count& count) const {
    return list(key, fallback ? &*fallback : nullptr, "a list of strings", count,
                [&](const ConfigNode& item) {
                    if (item.kind != ValueKind::string) throw wrong_type(key, item, "a string");
                    return item.string;
                });
}

Vec3 ConfigTable::vec3(std::string_view key, std::optional<Vec3> fallback, const Range& range) const {
    std::vector<double> list_fallback;
    if (fallback) list_fallback = {fallback->x, fallback->y, fallback->z};
    const std::vector<double> v =
        list(key, fallback ? &list_fallback : nullptr, "three numbers", exactly(3),
             [&](const ConfigNode& item) { return checked_number(key, item, range); });
    return {v[0], v[1], v[2]};
}

std::vector<std::vector<double>> ConfigTable::rows(std::string_view key, std::size_t columns,
                                                   const Count& count) const {
    return list<std::vector<double>>(key, nullptr, fmt::format("a list of rows of {} numbers", columns),
                                     count, [&](const ConfigNode& row) {
                                         if (row.kind != ValueKind::array || row.items.size() != columns)
                                             throw wrong_value(key, fmt::format("[… {} …]", shown(row)),
                                                               fmt::format("rows of {} numbers", columns));
                                         std::vector<double> values;
                                         for (const ConfigNode& item : row.items)
                                             values.push_back(checked_number(key, item, {}));
                                         return values;
                                     });
}

std::map<std::string, double> ConfigTable::number_map(std::string_view key) const {
    std::map<std::string, double> values;
    const ConfigTable names = table(key);
    if (names.present())
        for (const std::string& name : names.node_->keys) values[name] = names.number(name, kRequired);
    return values;
}

std::string ConfigTable::one_of(std::string_view key, std::optional<std::string> fallback,
                                std::span<const std::string> names) const {
    std::string expected;
    for (std::size_t i = 0; i < names.size(); ++i)
        expected += (i == 0 ? "" : i + 1 == names.size() ? " or " : ", ") + in_quotes(names[i]);
    const ConfigNode* node = need(key, expected, fallback.has_value());
    if (node == nullptr) return recorded(key, *fallback);
    if (node->kind != ValueKind::string) throw wrong_type(key, *node, expected);
    if (std::find(names.begin(), names.end(), node->string) == names.end())
        throw wrong_value(key, shown(*node), expected);
    return recorded(key, node->string);
}

std::filesystem::path ConfigTable::file(std::string_view key) const {
    const std::string name = text(key, kRequired);
    if (name.empty() || name.find('\0') != std::string::npos)
        throw wrong_value(key, in_quotes(name), "the path of a file");
    return document_->directory / name;
}

ConfigTable ConfigTable::table(std::string_view key) const {
    const ConfigNode* node = find(key);
    if (node != nullptr && node->kind != ValueKind::table) throw wrong_type(key, *node, "a table");
    ConfigTable out = *this;
    out.node_ = node;
    if (node != nullptr) out.nearest_ = node;
    out.path_.push_back({std::string(key), std::nullopt});
    out.prefix_ += std::string(key) + ".";
    return out;
}

std::vector<ConfigTable> ConfigTable::tables(std::string_view key) const {
    std::vector<ConfigTable> out;
    const ConfigNode* node = find(key);
    if (node == nullptr) return out;
    if (node->kind != ValueKind::array) throw wrong_type(key, *node, "a list of tables");
    for (std::size_t i = 0; i < node->items.size(); ++i) {
        const ConfigNode& item = node->items[i];
        if (item.kind != ValueKind::table) throw wrong_type(key, item, "a table");
        ConfigTable element = *this;
        element.node_ = element.nearest_ = &item;
        element.path_.push_back({std::string(key), std::nullopt});
        element.path_.push_back({{}, i});
        if (label_.empty() && prefix_.empty()) {
            const ConfigNode* name = item.find("name");
            const bool named = name != nullptr && name->kind == ValueKind::string;
            element.label_ =
                named ? fmt::format("{} {}", key, in_quotes(name->string)) : fmt::format("{} {}", key, i);
        } else {
            element.prefix_ += fmt::format("{}[{}].", key, i);
        }
        out.push_back(std::move(element));
    }
    return out;
}

}  // namespace pellucid
