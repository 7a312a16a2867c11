#!/bin/sh
# Fetches the source package $1 through apt into the directory $2, for a machine
# that reaches a Debian or Ubuntu mirror but not GitHub. Needs no root: apt works
# on directories of its own under $2, and the system's lists, caches and sources
# stay as they are. The proxy, the sign-in and the keys of the system still count.
set -eu
package=$1
work=$2
mkdir -p "$work/sources.list.d" "$work/state/lists/partial" "$work/cache/archives/partial" "$work/download"

# The system's own sources, with source packages in place of binary ones. Other
# hosts' lists come along and may fail: nothing depends on them.
for list in /etc/apt/sources.list /etc/apt/sources.list.d/*.list; do
	[ -r "$list" ] || continue
	sed -n 's/^[[:space:]]*deb\([[:space:]]\)/deb-src\1/p' "$list" >"$work/sources.list.d/$(basename "$list" .list).list"
done
for list in /etc/apt/sources.list.d/*.sources; do
	[ -r "$list" ] || continue
	sed 's/^[Tt]ypes:.*/Types: deb-src/' "$list" >"$work/sources.list.d/$(basename "$list")"
done

# Read last, after /etc/apt/apt.conf.d. Its hooks are cleared: they tidy and
# refresh what belongs to the system.
cat >"$work/apt.conf" <<END
Dir::Etc::sourcelist "/dev/null";
Dir::Etc::sourceparts "$work/sources.list.d";
Dir::State "$work/state";
Dir::State::status "/dev/null";
Dir::Cache "$work/cache";
Dir::Log "$work";
#clear APT::Update::Pre-Invoke;
#clear APT::Update::Post-Invoke;
#clear APT::Update::Post-Invoke-Success;
#clear Acquire::IndexTargets::deb-src::DEP-11;
Acquire::Languages "none";
Acquire::Retries "1";
Acquire::http::Timeout "20";
Acquire::https::Timeout "20";
APT::Sandbox::User "";
END

# one list that fails must not keep the others from being used
apt-get -q -c "$work/apt.conf" update || true
cd "$work/download"
apt-get -q -c "$work/apt.conf" source --download-only "$package"
