# shellcheck shell=sh
# Messages, the progress line, the log and the lock of a set-up. Read by ../vitac, which sets `root`.

: "${root:?set by ../vitac}"
log=$root/.system/setup.log

say() {
  printf 'vitac: %s\n' "$*" >&2
}

die() {
  say "$*"
  exit 1
}

# Shows a step of the set-up: one line that changes on a terminal, one line per step elsewhere.
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

# Runs a command with its output in the log; true where the command succeeded. Where the third argument is not
# empty, the lines that begin with it are counted on the terminal.
logged() { # heading, expected count or '', prefix of counted lines or '', command...
  heading=$1 expected=$2 prefix=$3
  shift 3
  step "$heading"
  {
    # A lock held by a killed set-up's children lasts until they end, so that nobody writes beside them.
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

# Ends the set-up with the cause that the log shows and the remedy for it.
fail_setup() { # what failed, MiB that it needs on the disk
  end_steps "$1 failed"
  if in_log 'No space left on device|Disk quota exceeded' || [ "$(free_mib)" -lt 20 ]; then
    die "the disk is full: $(free_mib) MiB are free in $root, about $2 MiB are needed. Make room and run the command again."
  elif in_log 'do not match the hashes|HASH'; then
    tail -n 15 "$log" >&2
    die "a download differs from what requirements/*.lock promises; nothing of it was installed. Run the command again, and if it stays so, look at the package index that pip is configured for."
  elif in_log 'name resolution|failed to resolve|could not resolve|new connection|max retries|connection (refused|reset|timed out|failed)|cannot connect|unreachable|timed out'; then
    die "the package index cannot be reached. Connect to the network (or set HTTPS_PROXY, or PIP_INDEX_URL for a mirror) and run the command again. Log: $log"
  elif in_log 'permission denied'; then
    die "no permission to write in $root. Log: $log"
  fi
  tail -n 10 "$log" >&2
  die "the cause was not recognised; the last lines are above, the whole log is in $log"
}

# Takes the set-up's lock on descriptor 9: two set-ups at once wait for each other.
lock_setup() { # python
  if ! mkdir -p "$root/.system" 2>/dev/null || [ ! -w "$root" ] || ! : 2>/dev/null >>"$root/.system/setup.lock"; then
    die "no permission to write in $root, where the set-up keeps .venv and .system. Clone the repository into a folder that is yours."
  fi
  exec 9>>"$root/.system/setup.lock"
  if "$1" -I -c 'import fcntl; fcntl.flock(9, fcntl.LOCK_EX | fcntl.LOCK_NB)' 2>/dev/null; then return; fi
  say "another set-up is running here; waiting for it"
  "$1" -I -c 'import fcntl; fcntl.flock(9, fcntl.LOCK_EX)' || die "cannot lock $root/.system/setup.lock"
}

unlock_setup() {
  exec 9>&-
}
