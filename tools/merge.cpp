// Adds the shards of one image up to the same bytes as a run without --shard:
//   merge OUT.exr SHARD.exr…      (each: render SCENE.toml --method particles --shard i/n -o SHARD.exr)
// Exit 0: written; 2: the files are not all the shards of one image; 4: the image could not be written.
#include <filesystem>
#include <string>
#include <vector>

#include "core/error.hpp"
#include "harness/options.hpp"
#include "io/image_file.hpp"
#include "render/shard.hpp"

namespace {

using namespace pellucid;
namespace fs = std::filesystem;

void require_output_apart(const fs::path& output, const std::vector<fs::path>& shards) {
    if (output.extension() != ".exr")
        throw input_error("{}: expected a name that ends in .exr: the background of a PNG is in the scene",
                          output.string());
    std::error_code ignored;
    for (const fs::path& shard : shards)
        if (fs::equivalent(output, shard, ignored))
            throw input_error("{}: the image would replace the shard {}", output.string(), shard.string());
}

}  // namespace

int main(int argc, char** argv) {
    return guarded_main("merge", [&] {
        std::string output;
        std::vector<std::string> shards;
        Arguments arguments(
            "merge", "Adds the shards of one image up to what one run would have drawn, byte for byte.");
        arguments.positional("OUT", output, "OUT.exr (float32, linear)");
        arguments.positionals("SHARD", shards, "files of render --shard 0/n ... n-1/n, in any order");
        if (!arguments.parse(argc, argv)) return 0;
        const std::vector<fs::path> files(shards.begin(), shards.end());
        require_output_apart(output, files);
        write_exr(merge_shards(files), output);
        return 0;
    });
}
