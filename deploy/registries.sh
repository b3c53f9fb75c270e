# To be sourced: what this machine is told about its package index and npm registry, told in another root.

# tell_pip ROOT: pip's options, and its certificates in a file of their own: the system's is made anew when ca-certificates is
# installed there.
tell_pip() {
  local root=$1 cert name value
  if [ -e /etc/resolv.conf ]; then cat /etc/resolv.conf >"$root/etc/resolv.conf"; fi
  echo '[global]' >"$root/etc/pip.conf"
  for name in index-url proxy trusted-host; do
    value=$(pip_option "$name")
    if [ -n "$value" ]; then echo "$name = $value" >>"$root/etc/pip.conf"; fi
  done
  cert=$(pip_option cert)
  if [ -n "$cert" ]; then
    cat "$cert" >"$root/etc/pip-cert.pem"
    echo "cert = /etc/pip-cert.pem" >>"$root/etc/pip.conf"
  fi
}

pip_option() {
  python3 -m pip config list 2>/dev/null | sed -n "s/^\(global\.\|:env:\.\)$1='\(.*\)'$/\2/p" | tail -n 1
}

# npm_settings ROOT: variables for npm there, one a line
npm_settings() {
  if [ -e "$1/etc/pip-cert.pem" ]; then echo NODE_EXTRA_CA_CERTS=/etc/pip-cert.pem; fi
  if [ -n "${npm_config_registry:-}" ]; then echo "npm_config_registry=$npm_config_registry"; fi
}
