//! Who may ask: the request's Host and Origin, and the token.
//!
//! A page of another site that resolves its name to this machine (DNS rebinding) sends its own name as Host:
//! only addresses and the configured names are taken. A page that posts here sends its own Origin.

use std::hint::black_box;
use std::net::{IpAddr, Ipv6Addr};

use axum::http::header::{AUTHORIZATION, COOKIE, HOST, HeaderMap, ORIGIN};
use axum::http::{StatusCode, Uri};

use super::json::Problem;
use crate::catalogue::ServiceFinding::{NoHost, NoToken, OtherHost, OtherSite};

/// The cookie of a page that has shown the token.
pub(super) const COOKIE_NAME: &str = "dbbd";
/// A shorter token can be guessed.
const SHORTEST_TOKEN: usize = 16;

/// Who may ask.
#[derive(Debug)]
pub struct Access {
    loopback: bool,
    hosts: Vec<String>,
    token: Option<Token>,
    /// What the cookie of a page holds that has shown the token: drawn anew in each process.
    session: String,
}

/// What whoever asks must know. It is never shown.
pub struct Token(String);

impl std::fmt::Debug for Token {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        out.write_str("Token(..)")
    }
}

impl Token {
    /// From the text of its file, white space around it left out; none if it is too short, or has a
    /// character that a header cannot carry.
    pub fn new(text: &str) -> Option<Self> {
        let text = text.trim();
        let sound = text.len() >= SHORTEST_TOKEN && text.bytes().all(|byte| byte.is_ascii_graphic());
        sound.then(|| Self(text.to_owned()))
    }
}

/// Compares in a time that reveals nothing of `secret` but its length.
fn same(shown: &[u8], secret: &[u8]) -> bool {
    let mut different = u8::from(shown.len() != secret.len());
    for (one, other) in shown.iter().zip(secret.iter().cycle()) {
        different |= black_box(one ^ other);
    }
    black_box(different) == 0 && !secret.is_empty()
}

impl Access {
    /// For a service at `address`, under these names beside its addresses.
    pub fn new(address: IpAddr, hosts: &[String], token: Option<Token>, session: String) -> Self {
        let hosts = hosts.iter().map(|host| host.to_ascii_lowercase()).collect();
        Self { loopback: address.is_loopback(), hosts, token, session }
    }

    /// Whether Host and Origin are in order.
    pub(super) fn check_site(&self, uri: &Uri, headers: &HeaderMap, api: bool) -> Result<(), Problem> {
        let host = headers.get(HOST).and_then(|host| host.to_str().ok());
        let Some(host) = host.filter(|_| headers.get_all(HOST).iter().count() == 1) else {
            return Err(Problem::new(StatusCode::BAD_REQUEST, NoHost));
        };
        let authority = uri.authority().map_or(host, |authority| authority.as_str());
        if !self.knows(host) || !authority.eq_ignore_ascii_case(host) {
            return Err(Problem::new(StatusCode::MISDIRECTED_REQUEST, OtherHost));
        }
        let foreign = || Problem::new(StatusCode::FORBIDDEN, OtherSite);
        if let Some(origin) = headers.get(ORIGIN) {
            let origin = origin.to_str().map_err(|_| foreign())?;
            let own = origin.strip_prefix("http://").or_else(|| origin.strip_prefix("https://"));
            if !own.is_some_and(|own| own.eq_ignore_ascii_case(host)) {
                return Err(foreign());
            }
        }
        let site = headers.get("sec-fetch-site").and_then(|site| site.to_str().ok());
        if api && matches!(site, Some("cross-site" | "same-site")) {
            return Err(foreign());
        }
        Ok(())
    }

    fn knows(&self, host: &str) -> bool {
        let name = match host.strip_prefix('[').and_then(|rest| rest.split_once(']')) {
            Some((address, _)) => return address.parse::<Ipv6Addr>().is_ok_and(|ip| self.serves(ip.into())),
            None => host.rsplit_once(':').map_or(host, |(name, _)| name),
        };
        match name.parse::<IpAddr>() {
            Ok(ip) => self.serves(ip),
            Err(_) => {
                name.eq_ignore_ascii_case("localhost") || self.hosts.contains(&name.to_ascii_lowercase())
            }
        }
    }

    fn serves(&self, ip: IpAddr) -> bool {
        !self.loopback || ip.is_loopback()
    }

    /// Whether whoever asks knows the token, by header or by the cookie of a page.
    pub(super) fn check_token(&self, headers: &HeaderMap) -> Result<(), Problem> {
        let Some(token) = &self.token else { return Ok(()) };
        let bearer = headers.get(AUTHORIZATION).map(|value| value.as_bytes());
        let bearer = bearer.and_then(|value| value.strip_prefix(b"Bearer "));
        if bearer.is_some_and(|shown| same(shown, token.0.as_bytes())) {
            return Ok(());
        }
        let cookies = headers.get_all(COOKIE).iter().filter_map(|value| value.to_str().ok());
        let mut sessions = cookies
            .flat_map(|value| value.split(';'))
            .filter_map(|pair| pair.trim().strip_prefix(COOKIE_NAME)?.strip_prefix('='));
        if sessions.any(|shown| same(shown.as_bytes(), self.session.as_bytes())) {
            return Ok(());
        }
        Err(Problem::new(StatusCode::UNAUTHORIZED, NoToken))
    }

    /// The cookie for a page that shows the token.
    pub(super) fn session_for(&self, shown: &str) -> Option<&str> {
        let known = self.token.as_ref().is_none_or(|token| same(shown.as_bytes(), token.0.as_bytes()));
        known.then_some(self.session.as_str())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn access(address: &str) -> Access {
        Access::new(address.parse().unwrap(), &["Cell-3".into()], None, String::new())
    }

    #[test]
    fn only_the_same_bytes_are_the_same() {
        assert!(same(b"0123456789abcdef", b"0123456789abcdef"));
        for wrong in [&b""[..], b"0123456789abcdeg", b"0123456789abcde", b"0123456789abcdef0123456789abcdef"]
        {
            assert!(!same(wrong, b"0123456789abcdef"));
        }
        assert!(!same(b"", b""));
    }

    #[test]
    fn names_of_others_are_not_served() {
        let local = access("127.0.0.1");
        for host in ["127.0.0.1:8230", "localhost", "LOCALHOST:1", "[::1]:8230", "cell-3:80"] {
            assert!(local.knows(host), "{host}");
        }
        for host in ["evil.example", "192.168.0.7:8230", "localhost.evil.example", "[::2]", "", ":80", "[::1"]
        {
            assert!(!local.knows(host), "{host}");
        }
        assert!(access("192.168.0.7").knows("192.168.0.7:8230"));
        assert!(!access("0.0.0.0").knows("rebound.example:8230"));
    }

    #[test]
    fn short_tokens_are_none() {
        assert!(Token::new("0123456789abcde\n").is_none());
        assert!(Token::new(" 0123456789abcdef\n").is_some());
        assert!(Token::new("0123456789abc def").is_none());
    }
}
