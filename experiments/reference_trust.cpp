// Is the ray-traced truth right: are its hits all there, its depths exact, its stated error true?
// configs/reference_trust.toml -> results/reference_trust/ -> analysis/reference_trust.py
#include "study/reference_trust.hpp"
#include "harness/experiment.hpp"

namespace {

using namespace pellucid;

struct Settings {
    ParitySettings parity;
    ClosedFormSettings closed_form;
    RootSettings roots;
    ImageSettingsOfTrust images;
    RestartSettings restart;
};

Settings read_settings(const ConfigTable& config) {
    (void)config.integer("seed", 1, {.lo = 0});
    return {read_parity_settings(config.table("parity")),
            read_closed_form_settings(config.table("closed_form")), read_root_settings(config.table("roots")),
            read_image_settings(config.table("images")), read_restart_settings(config.table("restart"))};
}

void run(Experiment& ex) {
    const Settings s = ex.config(read_settings);
    report_parity(ex, s.parity);
    report_closed_form(ex, s.closed_form);
    report_grazing(ex, s.closed_form);
    report_roots(ex, s.roots);
    report_stated_error(ex, s.images);
    report_particle_filter(ex, s.images);
    report_coincident(ex, s.images);
    report_restart(ex, s.restart);
}

}  // namespace

int main(int argc, char** argv) {
    return run_experiment(argc, argv, {"reference_trust", "Is the ray-traced truth right?"}, run);
}
