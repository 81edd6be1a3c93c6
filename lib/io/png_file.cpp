// libpng side of image_file.hpp. libpng leaves by longjmp, which must not skip destructors: the
// functions that call it hold plain values only, and all memory belongs to their callers.
#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>
#include <csetjmp>
#include <cstdio>
#include <memory>
#include <vector>

#include <png.h>

#include "core/color.hpp"
#include "core/error.hpp"
#include "io/atomic_file.hpp"
#include "io/image_file.hpp"
#include "io/input_file.hpp"

namespace pellucid {
namespace {

struct CloseFile {
    void operator()(std::FILE* file) const { std::fclose(file); }
};
using File = std::unique_ptr<std::FILE, CloseFile>;

struct Complaint {
    char text[160] = "";
};

void keep_and_jump(png_structp png, png_const_charp message) {
    auto* complaint = static_cast<Complaint*>(png_get_error_ptr(png));
    std::snprintf(complaint->text, sizeof complaint->text, "%s", message);
    png_longjmp(png, 1);
}

void ignore_warning(png_structp, png_const_charp) {}

struct Reader {
    Complaint complaint;
    png_structp png =
        png_create_read_struct(PNG_LIBPNG_VER_STRING, &complaint, keep_and_jump, ignore_warning);
    png_infop info = png != nullptr ? png_create_info_struct(png) : nullptr;

    Reader() = default;
    Reader(const Reader&) = delete;
    Reader& operator=(const Reader&) = delete;
    ~Reader() { png_destroy_read_struct(&png, &info, nullptr); }
};

struct Writer {
    Complaint complaint;
    png_structp png =
        png_create_write_struct(PNG_LIBPNG_VER_STRING, &complaint, keep_and_jump, ignore_warning);
    png_infop info = png != nullptr ? png_create_info_struct(png) : nullptr;

    Writer() = default;
    Writer(const Writer&) = delete;
    Writer& operator=(const Writer&) = delete;
    ~Writer() { png_destroy_write_struct(&png, &info); }
};

// Reads the header and asks for R, G, B, A of 8 or 16 bit, whatever is stored. gAMA is not used:
// the colours are taken as sRGB.
bool read_header(Reader& reader, std::FILE* file) {
    if (setjmp(png_jmpbuf(reader.png)) != 0) return false;
    png_init_io(reader.png, file);
    png_read_info(reader.png, reader.info);
    png_set_expand(reader.png);  // palette, 1, 2 and 4 bit grey, tRNS
    png_set_gray_to_rgb(reader.png);
    png_set_add_alpha(reader.png, 0xffff, PNG_FILLER_AFTER);
    return true;
}

bool start_rows(Reader& reader) {
    if (setjmp(png_jmpbuf(reader.png)) != 0) return false;
    png_set_interlace_handling(reader.png);
    png_read_update_info(reader.png, reader.info);
    return true;
}

bool read_rows(Reader& reader, png_bytepp rows) {
    if (setjmp(png_jmpbuf(reader.png)) != 0) return false;
    png_read_image(reader.png, rows);
    png_read_end(reader.png, nullptr);
    return true;
}

bool write_rows(Writer& writer, std::FILE* file, png_uint_32 width, png_uint_32 height, png_bytepp rows) {
    if (setjmp(png_jmpbuf(writer.png)) != 0) return false;
    png_init_io(writer.png, file);
    png_set_IHDR(writer.png, writer.info, width, height, 8, PNG_COLOR_TYPE_RGB, PNG_INTERLACE_NONE,
                 PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
    png_set_sRGB(writer.png, writer.info, PNG_sRGB_INTENT_PERCEPTUAL);
    png_write_info(writer.png, writer.info);
    png_write_image(writer.png, rows);
    png_write_end(writer.png, nullptr);
    return true;
}

std::vector<png_bytep> row_pointers(std::vector<png_byte>& bytes, std::size_t row_bytes) {
    std::vector<png_bytep> rows;
    for (std::size_t begin = 0; begin < bytes.size(); begin += row_bytes)
        rows.push_back(bytes.data() + begin);
    return rows;
}

// Clamped; NaN becomes 0.
png_byte to_byte(double linear) {
    const double inside = linear > 0 ? std::min(linear, 1.0) : 0.0;
    return static_cast<png_byte>(std::lround(255.0 * srgb_encode(inside)));
}

Image to_linear(const std::vector<png_byte>& bytes, int width, int height, bool two_bytes) {
    Image image(width, height);
    const std::array<std::span<float>, 4> planes = {image.add("R"), image.add("G"), image.add("B"),
                                                    image.add("A")};
    for (std::size_t i = 0; i < image.pixel_count(); ++i)
        for (std::size_t c = 0; c < 4; ++c) {
            const std::size_t at = 4 * i + c;
            const double stored =
                two_bytes ? (256 * bytes[2 * at] + bytes[2 * at + 1]) / 65535.0 : bytes[at] / 255.0;
            planes[c][i] = static_cast<float>(c == 3 ? stored : srgb_decode(stored));
        }
    return image;
}

}  // namespace

Image read_png(const std::filesystem::path& file) {
    const std::uint64_t file_bytes = input_file_size(file);
    const File in(std::fopen(file.c_str(), "rb"));
    if (!in) throw input_error("{}: cannot be read", file.string());
    Reader reader;
    if (reader.info == nullptr) throw run_error("{}: libpng has no memory", file.string());
    const auto damaged = [&] {
        return input_error("{}: not a readable PNG file: {}", file.string(), one_line(reader.complaint.text));
    };
    if (!read_header(reader, in.get())) throw damaged();

    // The size is held against the file before there is memory for it.
    const std::uint64_t width = png_get_image_width(reader.png, reader.info);
    const std::uint64_t height = png_get_image_height(reader.png, reader.info);
    const bool two_bytes = png_get_bit_depth(reader.png, reader.info) == 16;
    const std::uint64_t stored_bits = width * height * png_get_bit_depth(reader.png, reader.info) *
                                      png_get_channels(reader.png, reader.info);
    if (stored_bits / 8 / kMostInflation > file_bytes)
        throw input_error("{}: claims {} x {} pixels, more than {} bytes of file can hold", file.string(),
                          width, height, file_bytes);
    if (width * height * 4 * (sizeof(float) + 2) > available_memory())
        throw input_error("{}: {} x {} pixels do not fit in memory", file.string(), width, height);

    if (!start_rows(reader)) throw damaged();
    const std::size_t row_bytes = width * 4 * (two_bytes ? 2 : 1);
    if (png_get_rowbytes(reader.png, reader.info) != row_bytes)
        throw input_error("{}: has a layout of pixels that is not known", file.string());
    std::vector<png_byte> bytes(row_bytes * height);
    std::vector<png_bytep> rows = row_pointers(bytes, row_bytes);
    if (!read_rows(reader, rows.data())) throw damaged();
    return to_linear(bytes, static_cast<int>(width), static_cast<int>(height), two_bytes);
}

void write_png(const Image& image, const Vec3& background, const std::filesystem::path& file) {
    assert(image.has("R") && image.has("G") && image.has("B"));
    if (image.pixel_count() == 0)
        throw run_error("{}: an image of no pixels cannot be written", file.string());
    const std::array<std::span<const float>, 3> colour = {image.plane("R"), image.plane("G"),
                                                          image.plane("B")};
    const std::span<const float> alpha = image.has("A") ? image.plane("A") : std::span<const float>{};

    std::vector<png_byte> bytes(3 * image.pixel_count());
    for (std::size_t i = 0; i < image.pixel_count(); ++i)
        for (std::size_t c = 0; c < 3; ++c) {
            const double through = alpha.empty() ? 0.0 : 1.0 - static_cast<double>(alpha[i]);
            bytes[3 * i + c] =
                to_byte(static_cast<double>(colour[c][i]) + through * background[static_cast<int>(c)]);
        }
    std::vector<png_bytep> rows = row_pointers(bytes, 3 * static_cast<std::size_t>(image.width()));

    write_atomically(file, [&](const std::filesystem::path& temporary) {
        File out(std::fopen(temporary.c_str(), "wb"));
        if (!out) throw run_error("{}: cannot be written: no permission", file.string());
        Writer writer;
        if (writer.info == nullptr) throw run_error("{}: libpng has no memory", file.string());
        const bool written = write_rows(writer, out.get(), static_cast<png_uint_32>(image.width()),
                                        static_cast<png_uint_32>(image.height()), rows.data());
        if (std::fclose(out.release()) != 0 || !written)
            throw run_error("{}: cannot be written: {}", file.string(),
                            written ? "disk full" : one_line(writer.complaint.text));
    });
}

}  // namespace pellucid
