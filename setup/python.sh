# shellcheck shell=sh
# Keeps .venv in line with requirements/*.lock and pyproject.toml. Read by ../vitac, which sets `root`.
#
# .venv/vitac-stamp says what is installed: `<profile> <fingerprint> <place> <interpreter>`. If it is missing, the first
# set-up was interrupted and .venv is rebuilt, as after a move of the folder or of the interpreter. A .venv that was once
# complete is only changed in place, where other commands may be running from it: with an outdated fingerprint it is
# updated, and with `unfinished`, which it has while pip runs, the next command repairs it.

: "${root:?set by ../vitac}"
venv=$root/.venv
stamp=$venv/vitac-stamp
oldest_python=11
newest_python=14

fingerprint() {
  cat "$root/pyproject.toml" "$root"/requirements/*.lock "$root/setup/python.sh" | cksum | tr ' ' '-'
}

place() {
  printf '%s' "$root" | cksum | tr ' ' '-'
}

read_stamp() {
  has_profile='' has_fingerprint='' has_place='' has_interpreter=''
  if [ -r "$stamp" ]; then
    read -r has_profile has_fingerprint has_place has_interpreter <"$stamp" || true
  fi
}

# True if .venv was completed in this folder and still points to the interpreter that made it.
venv_is_valid() {
  [ "$has_place" = "$(place)" ] && [ -x "$venv/bin/python" ] && [ "$(readlink -f "$venv/bin/python")" = "$has_interpreter" ]
}

# Prints the smallest profile that has the packages of all those given. `base` is part of every profile, and `dev` has all.
joined_profiles() { # profiles...
  case "$*" in
    *dev*) echo dev ;;
    *server*show* | *show*server*) echo server+show ;;
    *server*) echo server ;;
    *show*) echo show ;;
    *) echo base ;;
  esac
}

installed_profile_covers() { # profile
  [ -n "$has_profile" ] && [ "$(joined_profiles "$has_profile" "$1")" = "$has_profile" ]
}

python_is_ready() { # profile
  read_stamp
  venv_is_valid && [ "$has_fingerprint" = "$(fingerprint)" ] && [ -x "$venv/bin/vitac" ] && installed_profile_covers "$1"
}

# Sets `python` to the newest interpreter that can create a virtual environment, or exits with what is missing.
find_python() {
  without_venv='' other=''
  probe='
import sys
minor = sys.version_info[1] if sys.version_info[0] == 3 else 0
if not int(sys.argv[1]) <= minor <= int(sys.argv[2]):
    print("version %d.%d" % sys.version_info[:2])
else:
    try:
        import ensurepip, venv
    except ImportError:
        print("venv %d.%d" % sys.version_info[:2])
    else:
        print("ready")
'
  if [ -n "${VITAC_PYTHON-}" ]; then
    set -- "$VITAC_PYTHON"
  else
    set -- python3.14 python3.13 python3.12 python3.11 python3
  fi
  for python in "$@"; do
    answer=$("$python" -I -c "$probe" "$oldest_python" "$newest_python" 2>/dev/null) || continue
    case $answer in
      ready) return ;;
      venv*) without_venv=${without_venv:-${answer#venv }} ;;
      *) other="$other $python is ${answer#version }." ;;
    esac
  done
  if [ -n "$without_venv" ]; then
    die "Python $without_venv has no venv module. Install it (Debian and Ubuntu: apt-get install python3-venv) and run the command again."
  fi
  die "expected Python 3.$oldest_python to 3.$newest_python, found none among $*.${other} Install one (Debian and Ubuntu: apt-get install python3 python3-venv) or name it in VITAC_PYTHON."
}

pip() {
  "$venv/bin/python" -I -m pip --disable-pip-version-check --no-input "$@"
}

# Installs the packages of a lock. Four processes fetch and unpack a part each, which their exact versions without
# dependencies allow; then all cores compile them.
install_lock() { # file
  parts=$root/.system/parts
  rm -rf "$parts"
  mkdir -p "$parts"
  awk -v file="$parts/${1##*/}" '/^[^ #]/ { part = count++ % 4 } count { print > (file "." part) }' "$1"
  children=''
  for part in "$parts"/*; do
    pip install --no-compile --require-hashes --only-binary :all: --no-deps -r "$part" &
    children="$children $!"
  done
  result=0
  for child in $children; do wait "$child" || result=1; done
  "$venv/bin/python" -I -m compileall -qq -j 0 "$venv"/lib/python3*/site-packages || true # some hold files for no Python
  return "$result"
}

# Symlinks `.dev/vitac/<folder>`, so that type checkers find `vitac.<folder>`.
link_packages() {
  mkdir -p "$root/.dev/vitac"
  sed -n 's/^"vitac\.[a-z_]*" = "\([a-z_]*\)"$/\1/p' "$root/pyproject.toml" | while read -r folder; do
    ln -sfn "../../$folder" "$root/.dev/vitac/$folder"
  done
}

write_stamp() { # profile, fingerprint
  printf '%s %s %s %s\n' "$1" "$2" "$(place)" "$(readlink -f "$venv/bin/python")" >"$stamp.new" && mv "$stamp.new" "$stamp"
}

# Exits with the cause. Where pip had not begun to install, .venv is as complete as before, and its stamp says so again.
fail_packages() { # what failed
  if [ -n "$has_profile" ] && ! in_log '^Installing collected packages'; then
    write_stamp "$has_profile" "$has_fingerprint" || true
  fi
  fail_setup "$1" 1000
}

install_python() { # profile
  started=$(date +%s)
  : >"$log"
  if venv_is_valid; then
    write_stamp "$has_profile" unfinished || fail_setup "writing $stamp" 1000
  else
    rm -rf "$venv"
    logged "creating .venv with $python" '' '' "$python" -I -m venv "$venv" || fail_setup "creating .venv" 1000
  fi
  for part in $(echo "$1" | tr + ' '); do
    lock=$root/requirements/$part.lock
    what="installing Python packages"
    logged "$what, once, about a minute" "$(grep -c '==' "$lock")" 'Collecting ' install_lock "$lock" || fail_packages "$what"
  done
  logged "installing ViTac Arena" '' '' \
    pip install --no-index --no-deps --no-build-isolation -e "$root" || fail_packages "installing ViTac Arena"
  link_packages
  write_stamp "$1" "$(fingerprint)"
  end_steps "Python packages are ready ($(($(date +%s) - started)) s)"
}

# Installs the packages of a profile into .venv: `base` to evaluate, `show` to draw as well, `server` to serve, `server+show` for
# both, `dev` to test. What other commands needed stays.
ensure_python() { # profile
  # These settings are for other installations and would install packages outside .venv.
  unset PIP_TARGET PIP_PREFIX PIP_ROOT PYTHONHOME
  export PIP_USER=0
  if python_is_ready "$1"; then return; fi
  find_python
  lock_setup "$python"
  if ! python_is_ready "$1"; then
    if ! venv_is_valid; then has_profile=''; fi
    install_python "$(joined_profiles "$has_profile" "$1")"
  fi
  unlock_setup
}
