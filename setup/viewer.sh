# shellcheck shell=sh
# Keeps web/static/playback.js, the player of the episode pages, in line with viewer. Read by ../vitac, which sets `root`.

: "${root:?set by ../vitac}"
viewer_stamp=$root/.system/viewer/stamp

viewer_fingerprint() {
  cat "$root"/viewer/*.js "$root"/viewer/*.json "$root/envs/playback_files/stage.json" "$root/requirements/node.lock" "$root/setup/build_viewer.sh" | cksum | tr ' ' '-'
}

viewer_is_built() {
  [ -f "$root/web/static/playback.js" ] && [ "$(cat "$viewer_stamp" 2>/dev/null)" = "$(viewer_fingerprint)" ]
}

# Builds the player if it is missing or outdated. Without it everything but the 3D playback works, so a failure only says so.
ensure_viewer() {
  if viewer_is_built; then return; fi
  if ! can_set_up; then
    say "Continuing without the 3D player: episode pages show still pictures."
    return
  fi
  if failed_lately player "$(viewer_fingerprint)"; then return; fi
  lock_setup "$venv/bin/python"
  if ! viewer_is_built; then
    : >"$log"
    if logged "building the 3D player" '' '' sh "$root/setup/build_viewer.sh" "$venv/bin/python"; then
      viewer_fingerprint >"$viewer_stamp"
      end_steps "the 3D player is ready"
    else
      note_failure player "$(viewer_fingerprint)"
      end_steps "the 3D player could not be built: npm's packages or node cannot be fetched here (log: $log)."
      say "Continuing without it: episode pages show still pictures. A start in an hour tries again."
    fi
  fi
  unlock_setup
}
