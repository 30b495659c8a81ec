# shellcheck shell=sh
# Finds the programs that are not Python packages (bubblewrap, gVisor's runsc, chromium), and installs or downloads missing ones.
# Read by ../vitac, which sets `root`; exports VITAC_BWRAP, VITAC_RUNSC and VITAC_CHROMIUM.
#
# As root they are installed as Debian packages. For a normal user the packages are unpacked in .system/, which works
# only for programs that run from any folder.

: "${root:?set by ../vitac}"
system=$root/.system
private_root=$system/root
apt=$system/apt

program_of() { # package
  case $1 in
    bubblewrap) echo bwrap ;;
    *) echo "$1" ;;
  esac
}

# Prints the program's path: the exported one, the system's, or the one in .system.
find_tool() { # package
  case $1:${VITAC_BWRAP:+bubblewrap}:${VITAC_CHROMIUM:+chromium} in
    bubblewrap:bubblewrap:*) echo "$VITAC_BWRAP" && return ;;
    chromium:*:chromium) echo "$VITAC_CHROMIUM" && return ;;
  esac
  command -v "$(program_of "$1")" && return
  if [ -x "$system/bin/$(program_of "$1")" ]; then echo "$system/bin/$(program_of "$1")"; else return 1; fi
}

install_as_root() { # package
  DEBIAN_FRONTEND=noninteractive apt-get -o DPkg::Lock::Timeout=300 install -y --no-install-recommends "$1"
}

# apt-get for a normal user: reads the machine's sources and installed packages, keeps lists and downloads in .system.
private_apt() {
  apt-get -o Dir::State="$apt/state" -o Dir::State::status=/var/lib/dpkg/status -o Dir::Cache="$apt/cache" \
    -o Debug::NoLocking=1 "$@"
}

# Unpacks a package, and those of its dependencies that the machine lacks, below .system/root.
unpack_privately() { # package
  mkdir -p "$apt/state/lists/partial" "$apt/cache/archives/partial" "$apt/downloads" "$private_root" "$system/bin" &&
    private_apt update &&
    private_apt -s install --no-install-recommends "$1" >"$apt/plan" &&
    (
      cd "$apt/downloads" &&
        sed -n 's/^Inst \([^ ]*\) .*/\1/p' "$apt/plan" | sort -u | private_xargs download &&
        for archive in ./*.deb; do dpkg-deb --extract "$archive" "$private_root" || exit 1; done
    ) && rm -rf "$apt"
}

private_xargs() { # apt-get command; package names on standard input
  # shellcheck disable=SC2046  # package names contain no spaces
  private_apt "$@" $(cat)
}

# Writes .system/bin/<program>, which runs an unpacked program with its unpacked libraries.
wrap_privately() { # package
  program=$(program_of "$1")
  case $1 in
    chromium) binary=usr/lib/chromium/chromium ;;
    *) binary=usr/bin/$program ;;
  esac
  [ -x "$private_root/$binary" ] || return 1
  cat >"$system/bin/$program.new" <<EOF
#!/bin/sh
# Written by setup/tools.sh.
system=\$(CDPATH='' cd -- "\$(dirname -- "\$0")/.." && pwd -P)
for folder in "\$system"/root/lib/*-linux-gnu* "\$system"/root/usr/lib/*-linux-gnu* "\$system"/root/usr/lib/*/pulseaudio; do
  if [ -d "\$folder" ]; then LD_LIBRARY_PATH=\${LD_LIBRARY_PATH:+\$LD_LIBRARY_PATH:}\$folder; fi
done
export LD_LIBRARY_PATH
if [ -f "\$system/fonts.conf" ]; then export FONTCONFIG_FILE="\$system/fonts.conf"; fi
exec "\$system/root/$binary" "\$@"
EOF
  chmod +x "$system/bin/$program.new" && mv "$system/bin/$program.new" "$system/bin/$program"
}

# The unpacked fonts' configuration names folders below /, so chromium gets one that names ours.
write_font_configuration() {
  cat >"$system/fonts.conf" <<EOF
<?xml version="1.0"?>
<fontconfig>
  <dir>$private_root/usr/share/fonts</dir>
  <dir>/usr/share/fonts</dir>
  <cachedir>$system/font-cache</cachedir>
</fontconfig>
EOF
}

install_tool() { # package
  if [ "$(id -u)" = 0 ]; then
    logged "installing $1" '' '' install_as_root "$1" ||
      { logged "updating the package lists" '' '' apt-get update && logged "installing $1" '' '' install_as_root "$1"; }
  else
    logged "downloading $1 into .system" '' '' unpack_privately "$1" && write_font_configuration && wrap_privately "$1"
  fi
}

# Prints what to install by hand if the set-up cannot.
advise_tool() { # package, reason
  say "$1 is missing and cannot be installed here: $2."
  if command -v dnf >/dev/null; then
    say "install it with: dnf install $1"
  elif command -v pacman >/dev/null; then
    say "install it with: pacman -S $1"
  elif command -v zypper >/dev/null; then
    say "install it with: zypper install $1"
  else
    say "install it with: apt-get install $1 (as root), or your system's package of that name"
  fi
}

export_tool() { # package, path
  case $1 in
    bubblewrap) export VITAC_BWRAP="$2" ;;
    runsc) export VITAC_RUNSC="$2" ;;
    chromium) export VITAC_CHROMIUM="$2" ;;
  esac
}

# Exports the program's path, installing the program first if it is missing. False if that is not possible.
ensure_tool() { # package
  if ! find_tool "$1" >/dev/null; then
    if ! command -v apt-get >/dev/null; then
      advise_tool "$1" "this system has no apt-get"
      return 1
    fi
    lock_setup "$venv/bin/python"
    if ! find_tool "$1" >/dev/null; then
      : >"$log"
      if install_tool "$1" && find_tool "$1" >/dev/null; then
        end_steps "$1 is ready: $(find_tool "$1")"
      else
        unlock_setup
        end_steps "installing $1 failed"
        tail -n 5 "$log" >&2
        advise_tool "$1" "apt-get failed; the last lines of output are above, all of it is in $log"
        return 1
      fi
    fi
    unlock_setup
  fi
  export_tool "$1" "$(find_tool "$1")"
}
