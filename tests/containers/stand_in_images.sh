#!/bin/sh
# Builds stand-ins for the two base images from Debian's packages, for a machine that reaches no image registry.
# Run it as root: `sh tests/containers/stand_in_images.sh [MIRROR]`. What runs on them proves our own images and settings, not the
# published base images; their PostgreSQL is Debian's. Needs podman and debootstrap.
set -eu

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
root=$folder/root
debootstrap --variant=minbase --include=python3,python3-venv,ca-certificates,postgresql bookworm "$root" "$@"

ln -sf python3 "$root/usr/bin/python"
cp /etc/ssl/certs/ca-certificates.crt "$root/etc/ssl/certs/ca-certificates.crt" # also those of a proxy between
printf '[global]\ncert = /etc/ssl/certs/ca-certificates.crt\n' >"$root/etc/pip.conf"

cat >"$root/usr/local/bin/postgres-entry" <<'END'
#!/bin/sh
# Makes the database that POSTGRES_USER, POSTGRES_PASSWORD and POSTGRES_DB describe, then runs PostgreSQL.
set -eu
data=/var/lib/postgresql/data
programs=$(echo /usr/lib/postgresql/*/bin)
as_postgres() { setpriv --reuid postgres --regid postgres --clear-groups "$@"; }
mkdir -p "$data" /var/run/postgresql
chown postgres "$data" /var/run/postgresql
chmod 700 "$data"
if [ ! -s "$data/PG_VERSION" ]; then
  (umask 077 && printf '%s' "$POSTGRES_PASSWORD" >/tmp/password)
  chown postgres /tmp/password
  as_postgres "$programs/initdb" -D "$data" -U "$POSTGRES_USER" --pwfile=/tmp/password \
    --encoding=UTF8 --locale=C.UTF-8 --auth-host=scram-sha-256 --auth-local=trust
  rm /tmp/password
  echo "host all all all scram-sha-256" >>"$data/pg_hba.conf"
  echo "CREATE DATABASE \"$POSTGRES_DB\"" | as_postgres "$programs/postgres" --single -D "$data" postgres
  as_postgres "$programs/pg_ctl" -D "$data" -w -o "-c listen_addresses=" start
  for script in /docker-entrypoint-initdb.d/*.sh; do as_postgres sh "$script"; done
  as_postgres "$programs/pg_ctl" -D "$data" -w stop
fi
exec setpriv --reuid postgres --regid postgres --clear-groups "$programs/postgres" -D "$data" -c listen_addresses='*'
END
chmod 755 "$root/usr/local/bin/postgres-entry"

tar -C "$root" -c . | podman import - docker.io/library/python:3.11-slim-bookworm
tar -C "$root" -c . |
  podman import --change 'ENTRYPOINT ["/usr/local/bin/postgres-entry"]' - docker.io/library/postgres:17-bookworm
