#!/bin/sh
# Names the base images of Dockerfile and compose file by digest as well: `docker/pin.sh`, which needs their registry.
# `docker/pin.sh --check` lists those that are named by version only, and fails if there are any.
set -eu
cd "$(dirname "$0")/.."

list_images() {
    sed -nE 's/^(FROM|[[:space:]]*image:)[[:space:]]+([^[:space:]@]+:[^[:space:]@]+(@[^[:space:]]+)?).*/\2/p' "$1"
}

files=
for file in docker/Dockerfile docker-compose.yml; do
    [ ! -e "$file" ] || files="$files $file" # an image's build has the first one only
done

if [ "${1-}" = --check ]; then
    status=0
    for file in $files; do
        for image in $(list_images "$file" | grep -v '@sha256:' | sort -u); do
            echo "$file names $image by version only; docker/pin.sh adds its digest." >&2
            status=1
        done
    done
    exit $status
fi

edits=
for image in $(for file in $files; do list_images "$file"; done | sed 's/@.*//' | sort -u); do
    digest=$(docker buildx imagetools inspect "$image" --format '{{.Manifest.Digest}}')
    case $digest in
        sha256:*) edits="$edits;s|$image(@[^[:space:]]+)?|$image@$digest|" ;;
        *) echo "expected the digest of $image, got '$digest'; nothing was changed." >&2 && exit 1 ;;
    esac
done
# shellcheck disable=SC2086 # names of files without spaces
sed -i -E "$edits" $files
