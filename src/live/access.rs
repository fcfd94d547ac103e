//! Who may ask: the request's Host and Origin, and the token.
//!
//! A page of another site that resolves its name to this machine (DNS rebinding) sends its own name as Host:
//! only addresses and the configured names are taken. A page that posts here sends its own Origin.

use std::collections::VecDeque;
use std::hint::black_box;
use std::io;
use std::net::{IpAddr, Ipv6Addr};
use std::sync::Mutex;

use axum::http::header::{AUTHORIZATION, COOKIE, HOST, HeaderMap, ORIGIN};
use axum::http::{StatusCode, Uri};

use super::guesses::Guesses;
use super::json::Problem;
use crate::base::sync::lock;
use crate::catalogue::ServiceFinding::{
    NoHost, NoSystem, NoToken, OtherHost, OtherSite, TooManyGuesses, WrongToken,
};
use crate::diagnostic::Diagnostic;

/// The cookie of a page that has shown the token.
pub(super) const COOKIE_NAME: &str = "dbbd";
/// A shorter token can be guessed.
const SHORTEST_TOKEN: usize = 16;
/// Pages that are logged in at a time; the oldest is logged out by one more.
const MOST_SESSIONS: usize = 64;

/// Who may ask.
#[derive(Debug)]
pub struct Access {
    loopback: bool,
    hosts: Vec<String>,
    token: Option<Token>,
    /// What the cookies of the pages hold that have shown the token, the oldest first.
    sessions: Mutex<VecDeque<String>>,
    guesses: Mutex<Guesses>,
}

/// Whether a client has shown what it must know.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Shown {
    /// The token or a cookie, or none is needed.
    Right,
    Nothing,
    Wrong,
    /// Not looked at: too many wrong ones came from there.
    TooOften,
}

/// What nobody can guess, for a cookie.
fn drawn() -> io::Result<String> {
    let mut random = [0; 24];
    getrandom::fill(&mut random).map_err(io::Error::other)?;
    Ok(random.iter().map(|byte| format!("{byte:02x}")).collect())
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
    pub fn new(address: IpAddr, hosts: &[String], token: Option<Token>) -> Self {
        let hosts = hosts.iter().map(|host| host.to_ascii_lowercase()).collect();
        let (sessions, guesses) = (Mutex::default(), Mutex::default());
        Self { loopback: address.is_loopback(), hosts, token, sessions, guesses }
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
        for origin in headers.get_all(ORIGIN) {
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
        let Some(name) = without_port(host) else { return false };
        if let Some(address) = name.strip_prefix('[').and_then(|rest| rest.strip_suffix(']')) {
            return address.parse::<Ipv6Addr>().is_ok_and(|ip| self.serves(ip.into()));
        }
        match name.parse::<IpAddr>() {
            Ok(ip) => ip.is_ipv4() && self.serves(ip),
            Err(_) => {
                name.eq_ignore_ascii_case("localhost") || self.hosts.contains(&name.to_ascii_lowercase())
            }
        }
    }

    fn serves(&self, ip: IpAddr) -> bool {
        !self.loopback || ip.is_loopback()
    }

    /// Whether whoever asks from `address` knows the token, by header or by the cookie of a page.
    pub(super) fn shown(&self, headers: &HeaderMap, address: IpAddr) -> Shown {
        if self.token.is_none() || self.session(headers).is_some() {
            return Shown::Right;
        }
        let bearer = headers.get(AUTHORIZATION).map(|value| value.as_bytes());
        match bearer.and_then(|value| value.strip_prefix(b"Bearer ")) {
            Some(shown) => self.guess(shown, address),
            None => Shown::Nothing,
        }
    }

    /// Compares a token that was shown, and counts the wrong ones.
    fn guess(&self, shown: &[u8], address: IpAddr) -> Shown {
        let Some(token) = &self.token else { return Shown::Right };
        let mut guesses = lock(&self.guesses);
        if guesses.too_many(address) {
            return Shown::TooOften;
        }
        if same(shown, token.0.as_bytes()) {
            return Shown::Right;
        }
        guesses.wrong(address);
        Shown::Wrong
    }

    /// The cookie of a page that is logged in, where the request has one.
    fn session(&self, headers: &HeaderMap) -> Option<String> {
        let cookies = headers.get_all(COOKIE).iter().filter_map(|value| value.to_str().ok());
        let mut shown = cookies
            .flat_map(|value| value.split(';'))
            .filter_map(|pair| pair.trim().strip_prefix(COOKIE_NAME)?.strip_prefix('='));
        let sessions = lock(&self.sessions);
        shown.find_map(|one| sessions.iter().find(|known| same(one.as_bytes(), known.as_bytes())).cloned())
    }

    /// The cookie for a page that shows the token.
    pub(super) fn log_in(&self, shown: &str, address: IpAddr) -> Result<String, Problem> {
        match self.guess(shown.as_bytes(), address) {
            Shown::Right => {}
            Shown::TooOften => return Err(Diagnostic::new(TooManyGuesses).into()),
            Shown::Wrong | Shown::Nothing => return Err(Problem::new(StatusCode::UNAUTHORIZED, WrongToken)),
        }
        let session = drawn().map_err(|error| Diagnostic::new(NoSystem { why: error.to_string() }))?;
        let mut sessions = lock(&self.sessions);
        sessions.push_back(session.clone());
        if sessions.len() > MOST_SESSIONS {
            sessions.pop_front();
        }
        Ok(session)
    }

    /// The page's cookie is worth nothing from now on.
    pub(super) fn log_out(&self, headers: &HeaderMap) {
        if let Some(gone) = self.session(headers) {
            lock(&self.sessions).retain(|known| *known != gone);
        }
    }
}

/// The refusal of a client that has not shown what it must know.
pub(super) fn refusal(shown: Shown) -> Option<Problem> {
    match shown {
        Shown::Right => None,
        Shown::Nothing | Shown::Wrong => Some(Problem::new(StatusCode::UNAUTHORIZED, NoToken)),
        Shown::TooOften => Some(Diagnostic::new(TooManyGuesses).into()),
    }
}

/// The name or address in a Host, whose port must be a number.
fn without_port(host: &str) -> Option<&str> {
    let end = host.rfind(']').map_or(0, |bracket| bracket + 1);
    match host.get(end..)?.split_once(':') {
        None => Some(host),
        Some((rest, port)) => {
            let number = (1..=5).contains(&port.len()) && port.bytes().all(|byte| byte.is_ascii_digit());
            number.then(|| host.get(..end + rest.len())).flatten()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn access(address: &str) -> Access {
        Access::new(address.parse().unwrap(), &["Cell-3".into()], None)
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
        for host in [
            "evil.example",
            "192.168.0.7:8230",
            "localhost.evil.example",
            "[::2]",
            "",
            ":80",
            "[::1",
            "[::1].evil.example",
            "[::1]evil:80",
            "127.0.0.1:80@evil.example",
            "127.0.0.1:",
            "localhost:x",
            "::1",
        ] {
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
