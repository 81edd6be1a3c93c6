#include "study/stage_seconds.hpp"

#include "core/error.hpp"

namespace pellucid {

double stage_seconds(const RenderStats& stats, std::string_view name) {
    double sum = 0;
    bool found = false;
    for (const Stage& stage : stats.stages) {
        if (stage.name != name) continue;
        sum += stage.wall_s;
        found = true;
    }
    if (!found) throw run_error("no stage \"{}\" among the {} of this render", name, stats.stages.size());
    return sum;
}

}  // namespace pellucid
