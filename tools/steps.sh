# shellcheck shell=bash disable=SC2154
# Steps of ./check and ./reproduce: each is timed, silent while it goes well, and stops everything
# with its whole log where it fails. Sourced after `command` (the name in messages) is set.

step_summary=()

stop() {  # CODE MESSAGE: one line on stderr
    printf '%s: %s\n' "$command" "$2" >&2
    exit "$1"
}

# note_step NAME RESULT START: prints and keeps the line.
note_step() {
    local line
    line=$(printf '%-28s %-8s %5d s' "$1" "$2" $((SECONDS - $3)))
    step_summary+=("$line")
    printf '%s\n' "$line"
}

print_summary() {
    printf '\n'
    printf '%s\n' "${step_summary[@]}"
}

# run_step NAME COMMAND…: output goes to build/log/NAME.log; returns the command's exit code.
# `show_step=PATTERN` prints the lines of a good log from the first that matches PATTERN.
run_step() {
    local name=$1 start=$SECONDS code=0 log
    shift
    mkdir -p build/log
    log=build/log/${name// /_}.log
    if [ -t 1 ]; then printf '%s …\r' "$name"; fi
    "$@" >"$log" 2>&1 </dev/null || code=$?
    if [ "$code" = 0 ]; then
        if [ -n "${show_step:-}" ]; then sed -n "/$show_step/,\$p" "$log"; fi
        note_step "$name" ok "$start"
    else
        cat "$log" >&2
        note_step "$name" FAILED "$start"
    fi
    return "$code"
}

configure_and_build() {  # PRESET
    cmake --preset "$1" -DPELLUCID_PYTHON="$PYTHON" && cmake --build --preset "$1" -j "$(nproc)"
}

# The experiments there are, by name, in alphabetical order.
experiment_names() {
    local file
    for file in experiments/*.cpp; do
        if [ -e "$file" ]; then basename "$file" .cpp; fi
    done
}

# run_experiment NAME PRESET FOLDER [OPTION…]: the binary's own exit code.
run_experiment() {
    local name=$1 preset=$2 folder=$3
    shift 3
    local config=()
    if [ -e "configs/$name.toml" ]; then config=(--config "configs/$name.toml"); fi
    "build/release/bin/$name" "${config[@]}" --preset "$preset" --out "$folder" "$@"
}

draw_figures() {  # NAME FOLDER
    "$PYTHON" -B "analysis/$1.py" "$2"
}
