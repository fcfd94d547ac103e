//! Access control: the Host and Origin headers of a request, and its token or session cookie.
//!
//! DNS rebinding: a page of another site that resolves its name to this machine sends its own name as Host. Only
//! addresses and configured names are accepted as Host, and only the same host as Origin.

use dbbd_model::base::InternalFinding::NoSystem;
use std::collections::VecDeque;
use std::io;
use std::net::{IpAddr, Ipv6Addr, SocketAddr};
use std::sync::{Arc, Mutex};

use axum::http::header::{AUTHORIZATION, COOKIE, HOST, HeaderMap, ORIGIN};
use axum::http::{StatusCode, Uri};

use super::failed_logins::FailedLogins;
use super::json::Problem;
use super::users::{KnownUser, User, same};
use crate::live::ServiceFinding::{NoHost, NoToken, OtherHost, OtherSite, TooManyGuesses, WrongToken};
use dbbd_device::sync::lock;
use dbbd_model::diagnostic::Diagnostic;

/// Name of the session cookie.
pub(super) const COOKIE_NAME: &str = "dbbd";
/// Header in which a proxy names its client.
const FORWARDED_FOR: &str = "x-forwarded-for";
/// Number of sessions at a time. A new one ends the oldest.
const MAX_SESSIONS: usize = 64;

/// Which hosts a service answers for, and the users whose token its clients must send.
pub struct Access {
    loopback: bool,
    hosts: Vec<String>,
    /// Users with a token; if there are none, nobody is asked for a token.
    users: Vec<KnownUser>,
    /// Proxies whose `X-Forwarded-For` names the client.
    proxies: Vec<IpAddr>,
    /// The sessions, the oldest first.
    sessions: Mutex<VecDeque<Session>>,
    failed: Mutex<FailedLogins>,
}

/// A signed-in browser.
struct Session {
    /// The value of the session's cookie.
    cookie: String,
    user: Arc<User>,
}

/// The token or session cookie of a request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Credentials {
    /// The credentials of this user, or no token is required.
    Valid(Arc<User>),
    Missing,
    Wrong,
    /// Wrong, and too many wrong tokens came from this client before.
    TooManyWrong,
}

impl Credentials {
    pub(super) fn user(self) -> Result<Arc<User>, Problem> {
        match self {
            Self::Valid(user) => Ok(user),
            Self::Missing | Self::Wrong => Err(Problem::new(StatusCode::UNAUTHORIZED, NoToken)),
            Self::TooManyWrong => Err(Diagnostic::new(TooManyGuesses).into()),
        }
    }
}

/// A random cookie value of 192 bits.
fn random_cookie() -> io::Result<String> {
    let mut random = [0; 24];
    getrandom::fill(&mut random).map_err(io::Error::other)?;
    Ok(random.iter().map(|byte| format!("{byte:02x}")).collect())
}

impl Access {
    /// `hosts` are the names of the service besides its addresses.
    pub fn new(address: IpAddr, hosts: &[String], users: Vec<KnownUser>) -> Self {
        let hosts = hosts.iter().map(|host| host.to_ascii_lowercase()).collect();
        let (sessions, failed) = (Mutex::default(), Mutex::default());
        Self { loopback: address.is_loopback(), hosts, users, proxies: Vec::new(), sessions, failed }
    }

    /// Trusts these proxies to name their clients in `X-Forwarded-For`.
    #[must_use]
    pub fn behind(self, proxies: Vec<IpAddr>) -> Self {
        Self { proxies, ..self }
    }

    /// The address of the client: the address of the connection, or what a trusted proxy says. Each proxy adds the
    /// address that it sees at the end, so the last one that is no trusted proxy is the client, whatever is before
    /// it.
    pub(super) fn client(&self, headers: &HeaderMap, connected: IpAddr) -> IpAddr {
        let named = headers.get_all(FORWARDED_FOR).iter().rev();
        let named = named.flat_map(|value| value.to_str().unwrap_or_default().rsplit(','));
        let mut client = connected.to_canonical();
        for named in named.map(str::trim) {
            if !self.proxies.contains(&client) {
                break;
            }
            let address = named.parse().or_else(|_| named.parse().map(|socket: SocketAddr| socket.ip()));
            match address {
                Ok(address) => client = IpAddr::to_canonical(&address),
                Err(_) => break,
            }
        }
        client
    }

    /// Checks Host and Origin. `own_pages_only` also refuses links from other sites.
    pub(super) fn check_site(
        &self,
        uri: &Uri,
        headers: &HeaderMap,
        own_pages_only: bool,
    ) -> Result<(), Problem> {
        let host = headers.get(HOST).and_then(|host| host.to_str().ok());
        let Some(host) = host.filter(|_| headers.get_all(HOST).iter().count() == 1) else {
            return Err(Problem::new(StatusCode::BAD_REQUEST, NoHost));
        };
        let authority = uri.authority().map_or(host, |authority| authority.as_str());
        if !self.is_own_host(host) || !authority.eq_ignore_ascii_case(host) {
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
        if own_pages_only && matches!(site, Some("cross-site" | "same-site")) {
            return Err(foreign());
        }
        Ok(())
    }

    fn is_own_host(&self, host: &str) -> bool {
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

    /// Checks the session cookie, then the bearer token.
    pub(super) fn credentials(&self, headers: &HeaderMap, address: IpAddr) -> Credentials {
        if self.users.is_empty() {
            return Credentials::Valid(Arc::new(User::OWNER));
        }
        if let Some((_, user)) = self.session(headers) {
            return Credentials::Valid(user);
        }
        let bearer = headers.get(AUTHORIZATION).map(|value| value.as_bytes());
        match bearer.and_then(|value| value.strip_prefix(b"Bearer ")) {
            Some(token) => self.compare(token, address),
            None => Credentials::Missing,
        }
    }

    /// Compares a token with the tokens of all users and counts wrong ones. The right token is never limited:
    /// otherwise, someone who sends wrong ones could keep the operator behind the same address from *stop*.
    fn compare(&self, sent: &[u8], address: IpAddr) -> Credentials {
        if self.users.is_empty() {
            return Credentials::Valid(Arc::new(User::OWNER));
        }
        // All tokens are compared, so that the time does not tell whose token is nearly right.
        let known = self.users.iter().filter(|known| known.has(sent)).fold(None, |_, known| Some(known));
        if let Some(known) = known {
            return Credentials::Valid(Arc::clone(&known.user));
        }
        if lock(&self.failed).add(address) { Credentials::TooManyWrong } else { Credentials::Wrong }
    }

    /// The cookie of the request's session and its user, if the session exists.
    fn session(&self, headers: &HeaderMap) -> Option<(String, Arc<User>)> {
        let cookies = headers.get_all(COOKIE).iter().filter_map(|value| value.to_str().ok());
        let mut sent = cookies
            .flat_map(|value| value.split(';'))
            .filter_map(|pair| pair.trim().strip_prefix(COOKIE_NAME)?.strip_prefix('='));
        let sessions = lock(&self.sessions);
        let of = |one: &str| sessions.iter().find(|known| same(one.as_bytes(), known.cookie.as_bytes()));
        sent.find_map(|one| of(one).map(|known| (known.cookie.clone(), Arc::clone(&known.user))))
    }

    /// Starts a session and returns the value of its cookie.
    pub(super) fn log_in(&self, token: &str, address: IpAddr) -> Result<String, Problem> {
        let user = match self.compare(token.as_bytes(), address) {
            Credentials::Wrong => return Err(Problem::new(StatusCode::UNAUTHORIZED, WrongToken)),
            other @ (Credentials::Valid(_) | Credentials::Missing | Credentials::TooManyWrong) => {
                other.user()?
            }
        };
        let cookie = random_cookie().map_err(|error| Diagnostic::new(NoSystem { why: error.to_string() }))?;
        let mut sessions = lock(&self.sessions);
        sessions.push_back(Session { cookie: cookie.clone(), user });
        if sessions.len() > MAX_SESSIONS {
            sessions.pop_front();
        }
        Ok(cookie)
    }

    pub(super) fn log_out(&self, headers: &HeaderMap) {
        if let Some((ended, _)) = self.session(headers) {
            lock(&self.sessions).retain(|known| known.cookie != ended);
        }
    }
}

/// The name or address of a Host header. `None` if its port is not a number.
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
    use super::super::users::{Role, Token};
    use super::*;

    fn access(address: &str) -> Access {
        Access::new(address.parse().unwrap(), &["Cell-3".into()], Vec::new())
    }

    #[test]
    fn foreign_host_names_are_refused() {
        let local = access("127.0.0.1");
        for host in ["127.0.0.1:8230", "localhost", "LOCALHOST:1", "[::1]:8230", "cell-3:80"] {
            assert!(local.is_own_host(host), "{host}");
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
            assert!(!local.is_own_host(host), "{host}");
        }
        assert!(access("192.168.0.7").is_own_host("192.168.0.7:8230"));
        assert!(!access("0.0.0.0").is_own_host("rebound.example:8230"));
    }

    #[test]
    fn client_is_what_the_last_trusted_proxy_saw() {
        let proxied =
            access("127.0.0.1").behind(vec!["127.0.0.1".parse().unwrap(), "10.0.0.9".parse().unwrap()]);
        let client = |connected: &str, named: &[&'static str]| {
            let mut headers = HeaderMap::new();
            for named in named {
                headers.append(FORWARDED_FOR, axum::http::HeaderValue::from_static(named));
            }
            proxied.client(&headers, connected.parse().unwrap()).to_string()
        };
        assert_eq!(client("127.0.0.1", &[]), "127.0.0.1");
        assert_eq!(client("127.0.0.1", &["192.168.7.1"]), "192.168.7.1");
        // The client itself sent the addresses before the last one.
        assert_eq!(client("127.0.0.1", &["1.2.3.4, 192.168.7.1"]), "192.168.7.1");
        assert_eq!(client("127.0.0.1", &["1.2.3.4", "192.168.7.1, 10.0.0.9"]), "192.168.7.1");
        assert_eq!(client("::ffff:127.0.0.1", &["[2001:db8::7]:443"]), "2001:db8::7");
        assert_eq!(client("127.0.0.1", &["unknown"]), "127.0.0.1");
        assert_eq!(client("127.0.0.1", &["192.168.7.1, 10.0.0.9, -"]), "127.0.0.1");
        // A client that is no trusted proxy cannot name another client.
        assert_eq!(client("192.168.7.1", &["192.168.7.2"]), "192.168.7.1");
        assert_eq!(client("127.0.0.1", &["10.0.0.9"]), "10.0.0.9");
    }

    #[test]
    fn right_token_is_valid_after_any_number_of_wrong_ones() {
        let hash = dbbd_model::base::hash::sha256("fedcba9876543210");
        let operator = KnownUser::named("operator".into(), Role::Measure, &hash).unwrap();
        let owner = KnownUser::owner(Token::new("0123456789abcdef").unwrap());
        let access = Access::new("127.0.0.1".parse().unwrap(), &[], vec![owner, operator]);
        let from = "10.0.0.1".parse().unwrap();
        let answers: Vec<_> = (0..1000).map(|_| access.compare(b"0123456789abcdeg", from)).collect();
        assert_eq!(
            [9, 10, 999].map(|at: usize| answers[at] == Credentials::TooManyWrong),
            [false, true, true]
        );
        let user = |token| access.compare(token, from).user().unwrap();
        assert_eq!(*user(b"0123456789abcdef"), User::OWNER);
        assert_eq!(
            (user(b"fedcba9876543210").name.as_deref(), user(b"fedcba9876543210").role),
            (Some("operator"), Role::Measure)
        );
        assert!(access.log_in("0123456789abcdef", from).is_ok());
    }
}
