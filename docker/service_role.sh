#!/bin/sh
# The image of PostgreSQL runs this once, when it makes the database: the service works as a role that owns no table.
set -eu

psql --set ON_ERROR_STOP=1 --set password="$VITAC_POSTGRES_PASSWORD" --username "$POSTGRES_USER" --dbname "$POSTGRES_DB" <<'SQL'
CREATE ROLE vitac_service LOGIN PASSWORD :'password';
SQL
