# shellcheck shell=sh
# Messages, progress line, output file and lock of a set-up. Read by ../vitac, which sets `root`.

: "${root:?set by ../vitac}"
log=$root/.system/setup.log

say() {
  printf 'vitac: %s\n' "$*" >&2
}

die() {
  say "$*"
  exit 1
}

# Shows a step of the set-up: a line that is overwritten on a terminal, a line per step elsewhere.
step() { # text
  if [ -t 2 ]; then
    printf '\r\033[Kvitac: %s' "$*" >&2
  else
    say "$*"
  fi
}

end_steps() { # text
  if [ -t 2 ]; then
    printf '\r\033[K' >&2
  fi
  say "$*"
}

# Runs a command with its output appended to $log; true if it succeeded. If the third argument is not empty, the
# terminal shows the number of lines that begin with it.
logged() { # heading, expected count or '', prefix of counted lines or '', command...
  heading=$1 expected=$2 prefix=$3
  shift 3
  step "$heading"
  {
    # The children of a killed set-up hold the lock until they end, so that no other set-up writes at the same time.
    if "$@" 2>&1 </dev/null; then echo "vitac-exit 0"; else echo "vitac-exit 1"; fi
  } | {
    count=0
    code=1
    while IFS= read -r line; do
      case $line in
        "vitac-exit "*)
          code=${line#vitac-exit }
          continue
          ;;
        "${prefix:-$heading no prefix}"*)
          count=$((count + 1))
          if [ -t 2 ]; then step "$heading [$count/$expected]"; fi
          ;;
        "Installing collected packages"*)
          if [ -t 2 ]; then step "$heading: unpacking"; fi
          ;;
      esac
      printf '%s\n' "$line" >>"$log"
    done
    exit "$code"
  }
}

in_log() { # extended regular expression
  grep -Eqi -- "$1" "$log" 2>/dev/null
}

free_mib() {
  df -Pk "$root" | awk 'NR == 2 { print int($4 / 1024) }'
}

# Exits with the cause found in $log and its remedy.
fail_setup() { # what failed, disk space that it needs [MiB]
  end_steps "$1 failed"
  if in_log 'No space left on device|Disk quota exceeded' || [ "$(free_mib)" -lt 20 ]; then
    die "the disk is full: $(free_mib) MiB are free in $root, about $2 MiB are needed. Free some space and run the command again."
  elif in_log 'do not match the hashes|HASH'; then
    tail -n 15 "$log" >&2
    die "a download does not match its hash in requirements/*.lock and was not installed. Run the command again; if it fails again, check the package index that pip is configured for."
  elif in_log 'name resolution|failed to resolve|could not resolve|new connection|max retries|connection (refused|reset|timed out|failed)|cannot connect|unreachable|timed out'; then
    die "the package index cannot be reached. Connect to the network (or set HTTPS_PROXY, or PIP_INDEX_URL for a mirror) and run the command again. Log: $log"
  elif in_log 'permission denied'; then
    die "no permission to write in $root. Log: $log"
  fi
  tail -n 10 "$log" >&2
  die "unknown cause; the last lines of output are above, all of it is in $log"
}

# False, with the reason, if the set-up may not write here.
can_set_up() {
  if mkdir -p "$root/.system" 2>/dev/null && [ -w "$root" ] && : 2>/dev/null >>"$root/.system/setup.lock"; then return; fi
  say "no permission to write in $root, where the set-up keeps .venv and .system. Clone the repository into a folder that you can write to."
  return 1
}

# Notes that something with this fingerprint could not be fetched or built, so that each start of the next hour does not try again.
note_failure() { # name, fingerprint
  printf '%s %s\n' "$(date +%s)" "$2" >"$root/.system/failed-$1"
}

# True, with the reason, if that was less than an hour ago.
failed_lately() { # name, fingerprint
  read -r failed_at failed_of 2>/dev/null <"$root/.system/failed-$1" || return 1
  case $failed_at in '' | *[!0-9]*) return 1 ;; esac
  if [ "$failed_of" != "$2" ] || [ $(($(date +%s) - failed_at)) -ge 3600 ]; then return 1; fi
  say "the $1 could not be fetched or built less than an hour ago; remove $root/.system/failed-$1 to try again now."
}

forget_failures() {
  rm -f "$root/.system/failed-"*
}

# Takes the set-up's lock on descriptor 9: two set-ups at once wait for each other.
lock_setup() { # python
  can_set_up || exit 1
  exec 9>>"$root/.system/setup.lock"
  if "$1" -I -c 'import fcntl; fcntl.flock(9, fcntl.LOCK_EX | fcntl.LOCK_NB)' 2>/dev/null; then return; fi
  say "another set-up is running here; waiting for it"
  "$1" -I -c 'import fcntl; fcntl.flock(9, fcntl.LOCK_EX)' || die "cannot lock $root/.system/setup.lock"
}

unlock_setup() {
  exec 9>&-
}
