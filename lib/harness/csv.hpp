// Tidy tables: one row per measurement, units in column names, not measured = empty cell.
#pragma once

#include <concepts>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace pellucid {

/// One cell as text. Numbers in the shortest form that reads back as the same bits.
[[nodiscard]] std::string csv_cell(double value);
[[nodiscard]] std::string csv_cell(float value);
[[nodiscard]] std::string csv_cell(std::int64_t value);
[[nodiscard]] std::string csv_cell(std::uint64_t value);
[[nodiscard]] std::string csv_cell(bool value);
/// In quotes where it holds a comma, a quote or a line break (RFC 4180).
[[nodiscard]] std::string csv_cell(std::string_view value);

template <std::signed_integral T>
[[nodiscard]] std::string csv_cell(T value) {
    return csv_cell(static_cast<std::int64_t>(value));
}
template <std::unsigned_integral T>
requires(!std::same_as<T, bool>) [[nodiscard]] std::string csv_cell(T value) {
    return csv_cell(static_cast<std::uint64_t>(value));
}
[[nodiscard]] inline std::string csv_cell(const std::string& value) {
    return csv_cell(std::string_view(value));
}
[[nodiscard]] inline std::string csv_cell(const char* value) {
    return csv_cell(std::string_view(value));
}
[[nodiscard]] inline std::string csv_cell(std::nullopt_t) {
    return {};
}
template <class T>
[[nodiscard]] std::string csv_cell(const std::optional<T>& value) {
    return value ? csv_cell(*value) : std::string{};
}

class CsvWriter {
public:
    CsvWriter(std::filesystem::path file, const std::vector<std::string>& columns);

    /// One row, a cell for each column; an empty optional is an empty cell.
    /// Throws std::logic_error for another number of cells.
    template <class... Cells>
    void row(const Cells&... cells) {
        write({csv_cell(cells)...});
    }
    /// The same with the number of cells known at run time only.
    void write(const std::vector<std::string>& cells);
    /// Writes out what is left. Throws Error(run) where the disk did not take it all.
    void close();

private:
    void put(const std::vector<std::string>& cells);

    std::filesystem::path file_;
    std::size_t columns_;
    std::ofstream out_;
};

}  // namespace pellucid
