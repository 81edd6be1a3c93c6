#!/bin/bash
# How fast is every stage beside a bare probe of this machine? Builds, measures (a few minutes on two
# idle cores) and prints the table; results/speed/ then holds speed.csv, speed.json and speed.md.
# Exit 0 all goals met, 1 a goal missed.
#   tools/speed.sh [--repetitions N] [--out DIR] [--filter REGEX]
#   tools/speed.sh --vtk [--repetitions N] [--out DIR]    beside VTK instead: vtk.csv, vtk.md. Exit 3: no VTK here
set -euo pipefail
command=speed.sh
usage="usage: tools/speed.sh [--vtk] [--repetitions N] [--out DIR] [--filter REGEX]"

repetitions=5 out='' filter=. vtk=
while [ $# -gt 0 ]; do
    case $1 in
        --repetitions | --out | --filter)
            [ $# -ge 2 ] || { echo "$command: $1 needs a value; $usage" >&2; exit 2; } ;;
        --vtk) vtk=1; shift; continue ;;
        -h | --help) echo "$usage"; exit 0 ;;
        *) echo "$command: unknown option $1; $usage" >&2; exit 2 ;;
    esac
    case $1 in
        --repetitions) repetitions=$2 ;;
        --out) out=$2 ;;
        --filter) filter=$2 ;;
    esac
    shift 2
done
case $repetitions in
    '' | *[!0-9]* | [0-4])
        echo "$command: --repetitions = '$repetitions', expected 5 or more" >&2
        exit 2 ;;
esac
case $out in '' | /*) ;; *) out=$PWD/$out ;; esac
cd "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/.."
out=${out:-results/speed}

# shellcheck source=tools/steps.sh
. tools/steps.sh
# shellcheck source=tools/setup.sh
. tools/setup.sh
run_step "build release" configure_and_build release || stop 4 "the build failed (above)"

if [ -n "$vtk" ]; then
    # Debian's VTK belongs to its own python3; VTK_PYTHON names another one.
    exec "${VTK_PYTHON:-/usr/bin/python3}" -B tools/vtk_peer.py build/release/bin/render "$out" --repetitions "$repetitions"
fi

raw=$(mktemp -d) || stop 4 "no temporary folder"
trap 'rm -rf "$raw"' EXIT
bench=build/release/bin/pellucid_bench
"$bench" --memory >"$raw/memory.json"
run_step "benchmarks" "$bench" --benchmark_filter="$filter" --benchmark_repetitions="$repetitions" \
    --benchmark_enable_random_interleaving=true \
    --benchmark_out="$raw/speed.json" --benchmark_out_format=json ||
    stop 4 "the benchmarks stopped (above)"
"$PYTHON" -B tools/bench_report.py "$raw/speed.json" "$raw/memory.json" "$out"
