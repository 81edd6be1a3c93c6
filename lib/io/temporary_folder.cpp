#include "io/temporary_folder.hpp"

#include <cstdlib>
#include <string>
#include <system_error>

#include "core/error.hpp"

namespace pellucid {

TemporaryFolder::TemporaryFolder() {
    // mkdtemp sets its own letters in place of the last six.
    std::string name = (std::filesystem::temp_directory_path() / "pellucid_XXXXXX").string();
    if (mkdtemp(name.data()) == nullptr) throw run_error("{}: no such folder can be made", name);
    path_ = name;
}

TemporaryFolder::~TemporaryFolder() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
}

}  // namespace pellucid
