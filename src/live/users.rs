//! The users who send requests: names, roles and secrets; and what they changed.

use std::collections::VecDeque;
use std::hint::black_box;
use std::sync::Arc;

use dbbd_model::base::hash::sha256;
use serde::{Deserialize, Serialize};

/// The actions that a user is permitted. Each role also permits the actions of the roles before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Role {
    /// Sees everything.
    Look,
    /// Connects the bar, starts and stops runs.
    Measure,
    /// Makes jobs, plans, results, corrected programs.
    Plan,
}

impl Role {
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Look => "look",
            Self::Measure => "measure",
            Self::Plan => "plan",
        }
    }
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct User {
    /// `None` for a user who has the token of the service, or where no token is asked for.
    pub name: Option<String>,
    pub role: Role,
}

impl User {
    /// The user who needs no name: the owner of the token file, or anybody where no token is asked for.
    pub(super) const OWNER: Self = Self { name: None, role: Role::Plan };
}

/// A user with the secret that identifies the sender of a request.
#[derive(Debug)]
pub struct KnownUser {
    pub(super) user: Arc<User>,
    secret: Secret,
}

#[derive(Debug)]
enum Secret {
    Token(Token),
    /// SHA-256 of a token, 64 hexadecimal digits in lower case.
    Hash(String),
}

impl KnownUser {
    pub fn owner(token: Token) -> Self {
        Self { user: Arc::new(User::OWNER), secret: Secret::Token(token) }
    }

    /// A user whose token has this SHA-256 in hexadecimal digits; `None` if the text is no SHA-256.
    pub fn named(name: String, role: Role, token_sha256: &str) -> Option<Self> {
        let hash = token_sha256.to_ascii_lowercase();
        let is_hash = hash.len() == 64 && hash.bytes().all(|byte| byte.is_ascii_hexdigit());
        let user = Arc::new(User { name: Some(name), role });
        is_hash.then_some(Self { user, secret: Secret::Hash(hash) })
    }

    pub(super) fn has(&self, sent: &[u8]) -> bool {
        match &self.secret {
            Secret::Token(Token(token)) => same(sent, token.as_bytes()),
            // Tokens are random: their hash needs no salt and no slowness.
            Secret::Hash(hash) => same(sha256(sent).as_bytes(), hash.as_bytes()),
        }
    }
}

/// A secret that clients must send. `Debug` does not print it.
pub struct Token(String);

impl std::fmt::Debug for Token {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        out.write_str("Token(..)")
    }
}

/// Minimum number of characters of a token: a shorter one can be guessed.
const SHORTEST_TOKEN: usize = 16;

impl Token {
    /// The content of a token file without white space at its ends. `None` if it is too short or has a character that a
    /// header cannot carry.
    pub fn new(text: &str) -> Option<Self> {
        let text = text.trim();
        let sound = text.len() >= SHORTEST_TOKEN && text.bytes().all(|byte| byte.is_ascii_graphic());
        sound.then(|| Self(text.to_owned()))
    }
}

/// Compares in a time that depends on the length of `secret` alone.
pub(super) fn same(sent: &[u8], secret: &[u8]) -> bool {
    let mut different = u8::from(sent.len() != secret.len());
    for (one, other) in sent.iter().zip(secret.iter().cycle()) {
        different |= black_box(one ^ other);
    }
    black_box(different) == 0 && !secret.is_empty()
}

/// A change that a user made.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(super) struct UserEvent {
    unix_ms: u64,
    /// `None` for the owner of the token of the service.
    user: Option<String>,
    /// Method and route, as `POST /api/v1/run`.
    act: String,
    path: String,
}

impl UserEvent {
    pub(super) fn new(unix_ms: u64, user: &User, act: String, path: String) -> Self {
        Self { unix_ms, user: user.name.clone(), act, path }
    }
}

/// The last events, the newest first.
#[derive(Debug, Default)]
pub(super) struct EventList(VecDeque<UserEvent>);

/// Events that are kept: a day of work.
const MAX_EVENTS: usize = 500;

impl EventList {
    pub(super) fn add(&mut self, event: UserEvent) {
        self.0.push_front(event);
        self.0.truncate(MAX_EVENTS);
    }

    pub(super) fn list(&self) -> Vec<UserEvent> {
        self.0.iter().cloned().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tokens_are_compared_byte_by_byte() {
        assert!(same(b"0123456789abcdef", b"0123456789abcdef"));
        for wrong in [&b""[..], b"0123456789abcdeg", b"0123456789abcde", b"0123456789abcdef0123456789abcdef"]
        {
            assert!(!same(wrong, b"0123456789abcdef"));
        }
        assert!(!same(b"", b""));
    }

    #[test]
    fn short_tokens_are_refused() {
        assert!(Token::new("0123456789abcde\n").is_none());
        assert!(Token::new(" 0123456789abcdef\n").is_some());
        assert!(Token::new("0123456789abc def").is_none());
    }

    /// printf %s 0123456789abcdef | sha256sum
    #[test]
    fn a_user_is_known_by_the_hash_of_the_token() {
        let hash = "9F9F5111F7B27A781F1F1DDDE5EBC2DD2B796BFC7365C9C28B548E564176929F";
        let user = KnownUser::named("A".into(), Role::Look, hash).unwrap();
        assert!(user.has(b"0123456789abcdef") && !user.has(b"0123456789abcdeg"));
        assert!(!user.has(hash.as_bytes()));
        for wrong in ["", &hash[1..], &hash.replace('9', "g")] {
            assert!(KnownUser::named("A".into(), Role::Look, wrong).is_none());
        }
    }

    #[test]
    fn the_oldest_events_are_dropped() {
        let mut events = EventList::default();
        for unix_ms in 0..=MAX_EVENTS as u64 {
            events.add(UserEvent::new(unix_ms, &User::OWNER, String::new(), String::new()));
        }
        let kept: Vec<u64> = events.list().iter().map(|event| event.unix_ms).collect();
        assert_eq!((kept.len(), kept[0], kept[MAX_EVENTS - 1]), (MAX_EVENTS, MAX_EVENTS as u64, 1));
    }
}
