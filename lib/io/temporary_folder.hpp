// A folder of our own, gone with the object: for files that are made to be read.
#pragma once

#include <filesystem>

namespace pellucid {

class TemporaryFolder {
public:
    /// Throws Error(run) where none can be made.
    TemporaryFolder();
    ~TemporaryFolder();
    TemporaryFolder(const TemporaryFolder&) = delete;
    TemporaryFolder& operator=(const TemporaryFolder&) = delete;
    [[nodiscard]] const std::filesystem::path& path() const { return path_; }

private:
    std::filesystem::path path_;
};

}  // namespace pellucid
