#include "harness/csv.hpp"

#include <stdexcept>

#include <fmt/format.h>

#include "core/error.hpp"

namespace pellucid {

std::string csv_cell(double value) {
    return fmt::format("{}", value);
}
std::string csv_cell(float value) {
    return fmt::format("{}", value);
}
std::string csv_cell(std::int64_t value) {
    return std::to_string(value);
}
std::string csv_cell(std::uint64_t value) {
    return std::to_string(value);
}
std::string csv_cell(bool value) {
    return value ? "true" : "false";
}

std::string csv_cell(std::string_view value) {
    if (value.find_first_of(",\"\r\n") == std::string_view::npos) return std::string(value);
    std::string out = "\"";
    for (const char c : value) {
        if (c == '"') out += '"';
        out += c;
    }
    return out += '"';
}

CsvWriter::CsvWriter(std::filesystem::path file, const std::vector<std::string>& columns)
    : file_(std::move(file)), columns_(columns.size()), out_(file_, std::ios::binary) {
    if (!out_) throw run_error("{}: cannot be written", file_.string());
    std::vector<std::string> names;
    for (const std::string& column : columns) names.push_back(csv_cell(column));
    put(names);
}

void CsvWriter::write(const std::vector<std::string>& cells) {
    if (cells.size() != columns_)
        throw std::logic_error(fmt::format("{}: a row of {} cells for {} columns", file_.filename().string(),
                                           cells.size(), columns_));
    put(cells);
}

void CsvWriter::put(const std::vector<std::string>& cells) {
    out_ << fmt::format("{}\n", fmt::join(cells, ","));
    if (!out_) throw run_error("{}: cannot be written, is the disk full?", file_.string());
}

void CsvWriter::close() {
    out_.close();
    if (!out_) throw run_error("{}: cannot be written, is the disk full?", file_.string());
}

}  // namespace pellucid
