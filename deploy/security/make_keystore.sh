#!/bin/sh
# SPDX-FileCopyrightText: 2026 Trackslip authors
# SPDX-License-Identifier: Apache-2.0
# Makes the keys and permissions of policy.xml for one domain and namespace, with the sros2 of a ROS 2 from apt:
#   ROS_DOMAIN_ID=17 ./make_keystore.sh /etc/trackslip/keystore [digger1]
# Permissions hold for the domain that is set while they are made. The private keys of the authority, in
# KEYSTORE/private, belong on no vehicle: move them to where they are kept.
set -eu
[ $# -ge 1 ] && [ $# -le 2 ] || { echo "usage: $0 KEYSTORE [NAMESPACE]" >&2; exit 2; }
case ${2-} in *[!a-zA-Z0-9_/]* | /* | */) echo "NAMESPACE: '$2' is refused; accepted: such as digger1" >&2; exit 2 ;; esac
command -v ros2 > /dev/null || { echo "ros2 is not found; source a ROS 2 from apt that has sros2" >&2; exit 2; }
folder=$(cd "$(dirname "$0")" && pwd)
policies=$(mktemp -d)
trap 'rm -rf "$policies"' EXIT
cp "$folder/node.xml" "$policies"
sed -e "s|enclave path=\"/|&${2:+$2/}|" -e "s|ns=\"/|&${2-}|" "$folder/policy.xml" > "$policies/policy.xml"
[ -d "$1" ] || ros2 security create_keystore "$1"
ros2 security generate_artifacts -k "$1" -p "$policies/policy.xml"
