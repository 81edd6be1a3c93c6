#!/bin/bash
# Every scene of scenes/ loads and renders, small, by both methods. Prints each broken claim; exit 1 if there is any.
# A scene whose data this machine lacks is named and skipped.
#   scenes_test.sh RENDER: the binary
set -u
render=$1
source_dir=$(dirname "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")")
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
broken=0 drawn=0
for scene in "$source_dir"/scenes/*.toml; do
    name=$(basename "$scene" .toml)
    head -1 "$scene" | grep -q '^# ' || { echo "BROKEN: $name does not open with a comment of what it shows"; broken=1; }
    missing=
    while read -r file; do
        [ -e "$file" ] || missing=$file
    done < <(grep -o '"/[^"]*"' "$scene" | tr -d '"')
    if [ -n "$missing" ]; then
        echo "skipped: $name, $missing is not here"
        continue
    fi
    for method in "particles --set particles.repeats=2" "reference --set reference.max_samples=64"; do
        # shellcheck disable=SC2086  # words on purpose
        if "$render" "$scene" --method $method --set 'image.resolution=[16,12]' --quiet -o "$work/$name.png" \
            2>"$work/err" && [ -s "$work/$name.png" ]; then
            drawn=$((drawn + 1))
        else
            echo "BROKEN: $name by ${method%% *}: $(cat "$work/err")"
            broken=1
        fi
        rm -f "$work/$name.png"
    done
done
[ "$drawn" -gt 0 ] || { echo "BROKEN: no scene was drawn"; broken=1; }
exit $broken
