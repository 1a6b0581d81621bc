//! Checks before a request is served: key, host, origin.

use std::net::{IpAddr, SocketAddr};

use axum::extract::{Request, State};
use axum::http::header::{
    CACHE_CONTROL, CONTENT_SECURITY_POLICY, HOST, ORIGIN, REFERRER_POLICY, X_CONTENT_TYPE_OPTIONS,
    X_FRAME_OPTIONS,
};
use axum::http::{HeaderMap, HeaderValue, StatusCode};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

/// The policy of pages: nothing from other sites, nothing inline.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src \
     'self'; worker-src 'self'; frame-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors \
     'none'";

/// The policy of a report, whose page contains its script and style. It is shown in a frame with a separate
/// origin, so it has access to neither the page nor its cookie nor the server.
const FRAMED_POLICY: &str = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; \
     base-uri 'none'; form-action 'none'; frame-ancestors 'self'; sandbox allow-scripts";

/// Marks a response that the page shows in a frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Framed;

/// What a key permits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Role {
    Operate,
    Watch,
}

/// Which requests are served.
#[derive(Clone, Debug)]
pub(crate) struct Gate {
    /// First part of every path, and what it permits.
    pub(crate) keys: Vec<(String, Role)>,
    /// Names that browsers may use; another name that resolves to this address is a rebinding attack.
    names: Vec<String>,
    /// Whether `Host` may be any numeric address, which no name service can rebind.
    any_address: bool,
    port: u16,
    scheme: &'static str,
}

impl Gate {
    pub(crate) fn new(
        keys: Vec<(String, Role)>,
        local: SocketAddr,
        names: &[String],
        is_encrypted: bool,
    ) -> Self {
        let names = names.iter().map(|name| name.to_ascii_lowercase());
        Self {
            keys,
            names: names.chain(["localhost".to_owned()]).collect(),
            any_address: !local.ip().is_loopback(),
            port: local.port(),
            scheme: if is_encrypted { "https" } else { "http" },
        }
    }

    fn is_own(&self, host: &str) -> bool {
        // Browsers omit the scheme's default port.
        let usual = if self.scheme == "https" { 443 } else { 80 };
        let (name, port) = match host.rsplit_once(':') {
            Some((name, port)) if !port.ends_with(']') => (name, port.parse().ok()),
            _ => (host, Some(usual)),
        };
        let address = name
            .trim_start_matches('[')
            .trim_end_matches(']')
            .parse::<IpAddr>();
        let is_known = match address {
            Ok(address) => self.any_address || address.is_loopback(),
            Err(_) => self.names.contains(&name.to_ascii_lowercase()),
        };
        port == Some(self.port) && is_known
    }

    /// The role of a request's key, or the reason why it is not served.
    fn role(&self, path: &str, headers: &HeaderMap) -> Result<Role, StatusCode> {
        let mut hosts = headers.get_all(HOST).iter();
        let host = hosts
            .next()
            .and_then(|value| value.to_str().ok())
            .unwrap_or_default();
        if hosts.next().is_some() || !self.is_own(host) {
            return Err(StatusCode::FORBIDDEN);
        }
        for origin in headers.get_all(ORIGIN) {
            let given = origin
                .to_str()
                .ok()
                .and_then(|text| text.strip_prefix(self.scheme)?.strip_prefix("://"));
            if !given.is_some_and(|given| given.eq_ignore_ascii_case(host)) {
                return Err(StatusCode::FORBIDDEN);
            }
        }
        let given = path.split('/').nth(1).unwrap_or_default();
        let found = self.keys.iter().filter(|(key, _)| is_same(given, key));
        found.map(|&(_, role)| role).next().ok_or(StatusCode::NOT_FOUND)
    }
}

/// Compares in a time that does not depend on the position of the difference.
fn is_same(given: &str, key: &str) -> bool {
    let differing = given
        .bytes()
        .zip(key.bytes())
        .fold(0, |bits, (a, b)| bits | (a ^ b));
    given.len() == key.len() && differing == 0
}

/// 128 random bits, for a key or the session of a page.
pub(crate) fn random_hex() -> std::io::Result<String> {
    use std::io::Read;
    let mut bytes = [0; 16];
    std::fs::File::open("/dev/urandom")?.read_exact(&mut bytes)?;
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

pub(crate) async fn pass(State(gate): State<Gate>, mut request: Request, next: Next) -> Response {
    let mut response = match gate.role(request.uri().path(), request.headers()) {
        Err(status) => status.into_response(),
        Ok(role) => {
            request.extensions_mut().insert(role);
            next.run(request).await
        }
    };
    let (policy, framing) = match response.extensions().get::<Framed>() {
        Some(Framed) => (FRAMED_POLICY, "SAMEORIGIN"),
        None => (POLICY, "DENY"),
    };
    let headers = response.headers_mut();
    for (name, value) in [
        (CONTENT_SECURITY_POLICY, policy),
        (X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (X_FRAME_OPTIONS, framing),
        (REFERRER_POLICY, "no-referrer"),
        (CACHE_CONTROL, "no-store"),
    ] {
        headers.insert(name, HeaderValue::from_static(value));
    }
    response
}

#[cfg(test)]
mod tests {
    use super::*;

    fn headers(host: &'static str, origin: Option<&'static str>) -> HeaderMap {
        let mut headers = HeaderMap::new();
        headers.insert(HOST, HeaderValue::from_static(host));
        if let Some(origin) = origin {
            headers.insert(ORIGIN, HeaderValue::from_static(origin));
        }
        headers
    }

    fn gate(local: &str, names: &[String], is_encrypted: bool) -> Gate {
        let keys = vec![
            ("k3y".to_owned(), Role::Operate),
            ("w4tch".to_owned(), Role::Watch),
        ];
        Gate::new(keys, local.parse().unwrap(), names, is_encrypted)
    }

    #[test]
    fn foreign_hosts_origins_and_keys_are_refused() {
        let gate = gate("127.0.0.1:5300", &[], false);
        let own = headers("127.0.0.1:5300", Some("http://127.0.0.1:5300"));
        assert_eq!(gate.role("/k3y/ws", &own), Ok(Role::Operate));
        assert_eq!(gate.role("/w4tch/ws", &own), Ok(Role::Watch));
        assert_eq!(
            gate.role("/k3y/", &headers("LocalHost:5300", None)),
            Ok(Role::Operate)
        );
        assert_eq!(
            gate.role("/k3y/", &headers("[::1]:5300", None)),
            Ok(Role::Operate)
        );
        let forbidden = Err(StatusCode::FORBIDDEN);
        for host in [
            "evil.example:5300",
            "127.0.0.1:80",
            "127.0.0.1",
            "",
            "192.168.0.5:5300",
            "[::1]",
            ":5300",
        ] {
            assert_eq!(gate.role("/k3y/", &headers(host, None)), forbidden, "{host}");
        }
        for origin in [
            "http://evil.example",
            "https://127.0.0.1:5300",
            "null",
            "http://127.0.0.1:53000",
            "http://localhost:5300",
        ] {
            let foreign = headers("127.0.0.1:5300", Some(origin));
            assert_eq!(gate.role("/k3y/ws", &foreign), forbidden, "{origin}");
        }
        assert_eq!(gate.role("/k3y/", &HeaderMap::new()), forbidden);
        for path in ["/", "/k3x/", "/k3/", "//k3y/", "/k3yy/", "/k3y%2f/"] {
            assert_eq!(gate.role(path, &own), Err(StatusCode::NOT_FOUND), "{path}");
        }
    }

    #[test]
    fn a_public_gate_serves_addresses_and_given_names() {
        let gate = gate("0.0.0.0:443", &["Mill.lan".to_owned()], true);
        for host in [
            "mill.lan",
            "mill.lan:443",
            "192.168.0.5",
            "[fe80::1]:443",
            "localhost",
        ] {
            assert_eq!(
                gate.role("/k3y/", &headers(host, None)),
                Ok(Role::Operate),
                "{host}"
            );
        }
        let own = headers("mill.lan", Some("https://mill.lan"));
        assert_eq!(gate.role("/k3y/", &own), Ok(Role::Operate));
        for host in [
            "evil.example",
            "mill.lan.evil.example",
            "192.168.0.5.evil.example",
            "mill.lan:80",
        ] {
            assert_eq!(
                gate.role("/k3y/", &headers(host, None)),
                Err(StatusCode::FORBIDDEN),
                "{host}"
            );
        }
    }
}
