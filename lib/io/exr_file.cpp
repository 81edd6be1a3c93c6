// OpenEXR side of image_file.hpp.
#include <fstream>
#include <memory>
#include <mutex>

#include <OpenEXR/ImfChannelList.h>
#include <OpenEXR/ImfFrameBuffer.h>
#include <OpenEXR/ImfHeader.h>
#include <OpenEXR/ImfInputPart.h>
#include <OpenEXR/ImfMultiPartInputFile.h>
#include <OpenEXR/ImfOutputFile.h>
#include <OpenEXR/ImfPartType.h>
#include <OpenEXR/ImfStdIO.h>
#include <OpenEXR/ImfStringAttribute.h>
#include <OpenEXR/ImfTileDescription.h>

#include "core/error.hpp"
#include "io/atomic_file.hpp"
#include "io/image_file.hpp"
#include "io/input_file.hpp"

namespace pellucid {
namespace {

// OpenEXR sizes its tables of rows and tiles by the header alone; with these limits a lie costs a
// few megabytes. Far above any image here.
constexpr int kMostPixelsAside = 1 << 20;
constexpr int kMostTileAside = 1 << 13;
constexpr std::uint64_t kMostPixels = std::uint64_t{1} << 31;

void limit_openexr() {
    static std::once_flag once;
    std::call_once(once, [] {
        Imf::Header::setMaxImageSize(kMostPixelsAside, kMostPixelsAside);
        Imf::Header::setMaxTileSize(kMostTileAside, kMostTileAside);
    });
}

// Rows that one chunk of a scanline file holds.
std::uint64_t rows_a_chunk(Imf::Compression compression) {
    switch (compression) {
        case Imf::NO_COMPRESSION:
        case Imf::RLE_COMPRESSION:
        case Imf::ZIPS_COMPRESSION:
            return 1;
        case Imf::ZIP_COMPRESSION:
        case Imf::PXR24_COMPRESSION:
            return 16;
        case Imf::DWAB_COMPRESSION:
            return 256;
        default:
            return 32;
    }
}

// Everything that would be allocated for this header, held against the file and the memory.
void check_claim(const Imf::Header& header, const std::filesystem::path& file, std::uint64_t file_bytes) {
    const Imath::Box2i& window = header.dataWindow();
    const auto width = static_cast<std::uint64_t>(std::int64_t{window.max.x} - window.min.x + 1);
    const auto height = static_cast<std::uint64_t>(std::int64_t{window.max.y} - window.min.y + 1);
    std::uint64_t channels = 0;
    std::uint64_t pixel_bytes = 0;  // in the file, before compression
    for (auto c = header.channels().begin(); c != header.channels().end(); ++c) {
        if (c.channel().xSampling != 1 || c.channel().ySampling != 1)
            throw input_error("{}: channel {} is sub-sampled, expected one sample a pixel", file.string(),
                              one_line(c.name()));
        ++channels;
        pixel_bytes += c.channel().type == Imf::HALF ? 2U : 4U;
    }
    if (channels == 0) throw input_error("{}: has no channel", file.string());

    // each chunk needs its place in the table (8 bytes), its head (8) and a byte of data
    std::uint64_t chunks =
        (height + rows_a_chunk(header.compression()) - 1) / rows_a_chunk(header.compression());
    if (header.hasTileDescription()) {
        const Imf::TileDescription& tile = header.tileDescription();
        chunks = ((width + tile.xSize - 1) / tile.xSize) * ((height + tile.ySize - 1) / tile.ySize);
    }
    const bool deflated =
        header.compression() == Imf::ZIP_COMPRESSION || header.compression() == Imf::ZIPS_COMPRESSION ||
        header.compression() == Imf::RLE_COMPRESSION || header.compression() == Imf::NO_COMPRESSION;
    const bool too_large_for_file =
        chunks * 17 > file_bytes || (deflated && width * height * pixel_bytes / kMostInflation > file_bytes);
    if (width * height > kMostPixels || too_large_for_file)
        throw input_error("{}: claims {} x {} pixels of {} channels, more than {} bytes of file can hold",
                          file.string(), width, height, channels, file_bytes);
    if (width * height * channels * sizeof(float) > available_memory())
        throw input_error("{}: {} x {} pixels of {} channels do not fit in memory", file.string(), width,
                          height, channels);
}

// The header of the one flat image that a file must hold.
const Imf::Header& checked_header(const Imf::MultiPartInputFile& exr, const std::filesystem::path& file,
                                  std::uint64_t file_bytes) {
    if (exr.parts() != 1)
        throw input_error("{}: has {} parts, expected one flat image", file.string(), exr.parts());
    const Imf::Header& header = exr.header(0);
    if (header.hasType() && !Imf::isImage(header.type()))
        throw input_error("{}: holds deep data, expected one flat image", file.string());
    check_claim(header, file, file_bytes);
    return header;
}

std::map<std::string, std::string> string_attributes(const Imf::Header& header) {
    std::map<std::string, std::string> attributes;
    for (auto a = header.begin(); a != header.end(); ++a)
        if (const auto* text = dynamic_cast<const Imf::StringAttribute*>(&a.attribute()))
            if (std::string_view(a.name()) != "type")
                attributes[a.name()] = text->value();  // type: scanline or tiled
    return attributes;
}

int width_of(const Imath::Box2i& window) { return window.max.x - window.min.x + 1; }
int height_of(const Imath::Box2i& window) { return window.max.y - window.min.y + 1; }

void read_slices(Imf::MultiPartInputFile& exr, const Imf::FrameBuffer& target, const Imath::Box2i& window) {
    Imf::InputPart part(exr, 0);
    part.setFrameBuffer(target);
    part.readPixels(window.min.y, window.max.y);
}

Image read_image(Imf::MultiPartInputFile& exr, const Imf::Header& header) {
    const Imath::Box2i& window = header.dataWindow();
    Image image(width_of(window), height_of(window));
    Imf::FrameBuffer target;  // a float slice makes OpenEXR convert half and uint
    for (auto c = header.channels().begin(); c != header.channels().end(); ++c)
        target.insert(c.name(), Imf::Slice::Make(Imf::FLOAT, image.add(c.name()).data(), window));
    read_slices(exr, target, window);
    image.attributes = string_attributes(header);
    return image;
}

// What `read` makes of the file and its header; everything that goes wrong there is Error(input).
template <class Read>
auto read_file(const std::filesystem::path& file, const Read& read) {
    limit_openexr();
    const std::uint64_t file_bytes = input_file_size(file);
    try {
        Imf::MultiPartInputFile exr(file.c_str(), 0, false);
        if (!exr.partComplete(0)) throw input_error("{}: is cut short", file.string());
        return read(exr, checked_header(exr, file, file_bytes));
    } catch (const Error&) {
        throw;
    } catch (const std::bad_alloc&) {
        throw input_error("{}: does not fit in memory", file.string());
    } catch (const std::exception& failure) {
        throw input_error("{}: not a readable OpenEXR file: {}", file.string(), one_line(failure.what()));
    }
}

}  // namespace

Image read_exr(const std::filesystem::path& file) { return read_file(file, read_image); }

ExrHeader read_exr_header(const std::filesystem::path& file) {
    return read_file(file, [](Imf::MultiPartInputFile&, const Imf::Header& header) {
        const Imath::Box2i& window = header.dataWindow();
        return ExrHeader{width_of(window), height_of(window), string_attributes(header)};
    });
}

void read_exr_words(const std::filesystem::path& file, int width, int height,
                    std::span<const WordTarget> targets) {
    read_file(file, [&](Imf::MultiPartInputFile& exr, const Imf::Header& header) {
        const Imath::Box2i& window = header.dataWindow();
        if (width_of(window) != width || height_of(window) != height)
            throw input_error("{}: has {} x {} pixels, expected {} x {}", file.string(), width_of(window),
                              height_of(window), width, height);
        Imf::FrameBuffer slices;
        for (const WordTarget& target : targets) {
            const Imf::Channel* channel = header.channels().findChannel(target.name);
            if (channel == nullptr || channel->type != Imf::UINT)
                throw input_error("{}: channel {} is {}, expected one of unsigned integers", file.string(),
                                  target.name, channel == nullptr ? "not there" : "of another type");
            slices.insert(target.name, Imf::Slice::Make(Imf::UINT, target.first, window, target.stride));
        }
        read_slices(exr, slices, window);
    });
}

void write_exr(const Image& image, const std::filesystem::path& file, std::span<const WordPlane> words) {
    limit_openexr();
    if (image.pixel_count() == 0)
        throw run_error("{}: an image of no pixels cannot be written", file.string());
    write_atomically(file, [&](const std::filesystem::path& temporary) {
        Imf::Header header(image.width(), image.height());
        header.compression() = Imf::ZIP_COMPRESSION;
        Imf::FrameBuffer source;
        for (const std::string& name : image.names()) {
            header.channels().insert(name, Imf::Channel(Imf::FLOAT));
            source.insert(name, Imf::Slice::Make(Imf::FLOAT, image.plane(name).data(), header.dataWindow()));
        }
        for (const WordPlane& plane : words) {
            header.channels().insert(plane.name, Imf::Channel(Imf::UINT));
            source.insert(plane.name,
                          Imf::Slice::Make(Imf::UINT, plane.first, header.dataWindow(), plane.stride));
        }
        for (const auto& [name, value] : image.attributes) header.insert(name, Imf::StringAttribute(value));

        std::ofstream stream(temporary, std::ios::binary);
        {
            Imf::StdOFStream out(stream, temporary.c_str());
            Imf::OutputFile exr(out, header, 0);
            exr.setFrameBuffer(source);
            exr.writePixels(image.height());
        }  // the table of rows is written by the destructor, which cannot tell of a full disk
        stream.close();
        if (!stream) throw run_error("{}: cannot be written: disk full, or no permission", file.string());
    });
}

}  // namespace pellucid
