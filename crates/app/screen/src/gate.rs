//! What passes before anything is looked at: key, host, origin.

use axum::extract::{Request, State};
use axum::http::header::{
    CACHE_CONTROL, CONTENT_SECURITY_POLICY, HOST, ORIGIN, REFERRER_POLICY, X_CONTENT_TYPE_OPTIONS, X_FRAME_OPTIONS,
};
use axum::http::{HeaderMap, HeaderValue, StatusCode};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

/// Nothing from elsewhere, nothing inline.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; \
     worker-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// Who may come in.
#[derive(Clone, Debug)]
pub(crate) struct Gate {
    /// First part of every path.
    pub(crate) key: String,
    /// `HOST:PORT` as a browser on this computer writes them. Another name that leads here is a rebinding.
    pub(crate) hosts: Vec<String>,
}

impl Gate {
    pub(crate) fn new(key: String, port: u16) -> Self {
        let hosts = ["127.0.0.1", "localhost", "[::1]"].map(|name| format!("{name}:{port}"));
        Self {
            key,
            hosts: hosts.into(),
        }
    }

    fn refusal(&self, path: &str, headers: &HeaderMap) -> Option<StatusCode> {
        let is_own = |host: &str| self.hosts.iter().any(|own| own == host);
        let mut hosts = headers.get_all(HOST).iter();
        let host = hosts.next().and_then(|value| value.to_str().ok());
        if hosts.next().is_some() || !host.is_some_and(is_own) {
            return Some(StatusCode::FORBIDDEN);
        }
        for origin in headers.get_all(ORIGIN) {
            let host = origin.to_str().ok().and_then(|text| text.strip_prefix("http://"));
            if !host.is_some_and(is_own) {
                return Some(StatusCode::FORBIDDEN);
            }
        }
        let given = path.split('/').nth(1).unwrap_or_default();
        (!is_same(given, &self.key)).then_some(StatusCode::NOT_FOUND)
    }
}

/// In a time that does not depend on where they differ.
fn is_same(given: &str, key: &str) -> bool {
    let differing = given.bytes().zip(key.bytes()).fold(0, |bits, (a, b)| bits | (a ^ b));
    given.len() == key.len() && differing == 0
}

pub(crate) async fn pass(State(gate): State<Gate>, request: Request, next: Next) -> Response {
    let refusal = gate.refusal(request.uri().path(), request.headers());
    let mut response = match refusal {
        Some(status) => status.into_response(),
        None => next.run(request).await,
    };
    let headers = response.headers_mut();
    for (name, value) in [
        (CONTENT_SECURITY_POLICY, POLICY),
        (X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (X_FRAME_OPTIONS, "DENY"),
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

    #[test]
    fn foreign_hosts_origins_and_keys_are_refused() {
        let gate = Gate::new("k3y".to_owned(), 5300);
        let headers = |host: &'static str, origin: Option<&'static str>| {
            let mut headers = HeaderMap::new();
            headers.insert(HOST, HeaderValue::from_static(host));
            if let Some(origin) = origin {
                headers.insert(ORIGIN, HeaderValue::from_static(origin));
            }
            headers
        };
        let own = headers("127.0.0.1:5300", Some("http://127.0.0.1:5300"));
        assert_eq!(gate.refusal("/k3y/ws", &own), None);
        assert_eq!(gate.refusal("/k3y/", &headers("localhost:5300", None)), None);
        let forbidden = Some(StatusCode::FORBIDDEN);
        for host in ["evil.example:5300", "127.0.0.1:80", "127.0.0.1", ""] {
            assert_eq!(gate.refusal("/k3y/", &headers(host, None)), forbidden, "{host}");
        }
        for origin in ["http://evil.example", "https://127.0.0.1:5300", "null", "http://127.0.0.1:53000"] {
            let foreign = headers("127.0.0.1:5300", Some(origin));
            assert_eq!(gate.refusal("/k3y/ws", &foreign), forbidden, "{origin}");
        }
        assert_eq!(gate.refusal("/k3y/", &HeaderMap::new()), forbidden);
        for path in ["/", "/k3x/", "/k3/", "//k3y/", "/k3yy/"] {
            assert_eq!(gate.refusal(path, &own), Some(StatusCode::NOT_FOUND), "{path}");
        }
    }
}
