//! Telnet with the COM port control option (RFC 854, 855, 856, 858, 2217), without I/O.

const IAC: u8 = 255;
const DONT: u8 = 254;
const DO: u8 = 253;
const WONT: u8 = 252;
const WILL: u8 = 251;
/// Start and end of a subnegotiation.
const SB: u8 = 250;
const SE: u8 = 240;

const BINARY: u8 = 0;
const SUPPRESS_GO_AHEAD: u8 = 3;
const COM_PORT: u8 = 44;
const SUPPORTED: [u8; 3] = [BINARY, SUPPRESS_GO_AHEAD, COM_PORT];

/// Longest subnegotiation that is kept, bytes; those of RFC 2217 have at most 6, except signatures.
const MAX_SUBNEGOTIATION_BYTES: usize = 256;

/// Commands of the client; the server's answers are these plus 100.
pub(crate) const SET_BAUD: u8 = 1;
pub(crate) const SET_DATA_BITS: u8 = 2;
pub(crate) const SET_PARITY: u8 = 3;
pub(crate) const SET_STOP_BITS: u8 = 4;
pub(crate) const SET_CONTROL: u8 = 5;
const SUSPEND: u8 = 8;
const RESUME: u8 = 9;
const ANSWER: u8 = 100;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TelnetSide {
    Client,
    Server,
    /// A client that only exchanges bytes: it leaves the line as the server has it.
    PlainClient,
}

#[derive(Clone, Copy, Debug)]
enum TelnetState {
    Data,
    /// An IAC was received.
    Command,
    /// One of the four verbs was received, which is stored.
    Option(u8),
}

/// One end of a telnet connection.
#[derive(Debug)]
pub struct Telnet {
    side: TelnetSide,
    place: TelnetState,
    /// The subnegotiation being received.
    inside: Option<Vec<u8>>,
    /// WILL and DO sent by this side, with their options.
    sent: Vec<(u8, u8)>,
    /// Whether the other side accepts the COM port option; `None` before it answered.
    com_port: Option<bool>,
    /// Answers that were not fetched yet.
    answers: Vec<(u8, Vec<u8>)>,
    suspended: bool,
}

/// Result of received bytes.
#[derive(Debug, Default)]
pub struct TelnetReceived {
    pub data: Vec<u8>,
    /// Bytes to be sent back.
    pub reply: Vec<u8>,
}

impl Telnet {
    /// Creates one end of a connection, and the greeting that it sends first.
    pub fn new(side: TelnetSide) -> (Self, Vec<u8>) {
        let mut sent = vec![(WILL, BINARY), (DO, BINARY), (WILL, SUPPRESS_GO_AHEAD), (DO, SUPPRESS_GO_AHEAD)];
        match side {
            TelnetSide::Client => sent.push((WILL, COM_PORT)),
            TelnetSide::Server => sent.push((DO, COM_PORT)),
            TelnetSide::PlainClient => {}
        }
        let greeting = sent.iter().flat_map(|(verb, option)| [IAC, *verb, *option]).collect();
        let telnet = Self {
            side,
            place: TelnetState::Data,
            inside: None,
            sent,
            com_port: None,
            answers: Vec::new(),
            suspended: false,
        };
        (telnet, greeting)
    }

    /// Whether the first bytes of a connection are those of a telnet server: a verb with an option.
    pub(crate) fn is_greeting(first: &[u8]) -> bool {
        // The options of RFC 855 to 4777 end at 49.
        matches!(first, [IAC, WILL | WONT | DO | DONT, 0..=49, ..])
    }

    /// Data with each IAC doubled.
    pub fn escaped(data: &[u8]) -> Vec<u8> {
        data.iter().flat_map(|&byte| std::iter::repeat_n(byte, if byte == IAC { 2 } else { 1 })).collect()
    }

    /// A command or an answer of RFC 2217 as sent.
    pub(crate) fn command(code: u8, value: &[u8]) -> Vec<u8> {
        [&[IAC, SB, COM_PORT, code], &Self::escaped(value)[..], &[IAC, SE]].concat()
    }

    /// Whether the other side accepts the COM port option; `None` before it answered.
    pub(crate) fn com_port(&self) -> Option<bool> {
        self.com_port
    }

    /// Whether the other side suspended the data.
    pub(crate) fn is_suspended(&self) -> bool {
        self.suspended
    }

    /// Removes and returns the latest answer to a command.
    pub(crate) fn answer(&mut self, code: u8) -> Option<Vec<u8>> {
        let place = self.answers.iter().rposition(|(answered, _)| *answered == code)?;
        let (_, value) = self.answers.swap_remove(place);
        self.answers.retain(|(answered, _)| *answered != code);
        Some(value)
    }

    pub fn receive(&mut self, bytes: &[u8]) -> TelnetReceived {
        let mut received = TelnetReceived::default();
        for &byte in bytes {
            match (self.place, byte) {
                (TelnetState::Data, IAC) => self.place = TelnetState::Command,
                (TelnetState::Data, _) => self.take(byte, &mut received),
                (TelnetState::Command, DONT | DO | WONT | WILL) => self.place = TelnetState::Option(byte),
                (TelnetState::Command, _) => {
                    self.place = TelnetState::Data;
                    match byte {
                        IAC => self.take(IAC, &mut received),
                        SB => self.inside = Some(Vec::new()),
                        SE => self.subnegotiated(&mut received),
                        _ => {}
                    }
                }
                (TelnetState::Option(verb), _) => {
                    self.place = TelnetState::Data;
                    self.negotiate(verb, byte, &mut received);
                }
            }
        }
        received
    }

    fn take(&mut self, byte: u8, received: &mut TelnetReceived) {
        match &mut self.inside {
            Some(inside) if inside.len() < MAX_SUBNEGOTIATION_BYTES => inside.push(byte),
            Some(_) => {}
            None => received.data.push(byte),
        }
    }

    /// Answers a verb about an option, unless it is itself an answer.
    fn negotiate(&mut self, verb: u8, option: u8, received: &mut TelnetReceived) {
        let (mine, yes) = match verb {
            DO | DONT => (WILL, verb == DO),
            _ => (DO, verb == WILL),
        };
        if option == COM_PORT {
            self.com_port = Some(yes || self.com_port == Some(true));
        }
        let refusal = if mine == WILL { WONT } else { DONT };
        let before = self.sent.iter().position(|sent| *sent == (mine, option));
        match (yes, before) {
            (true, Some(_)) | (false, None) => {}
            (true, None) if self.supports(option) => {
                self.sent.push((mine, option));
                received.reply.extend([IAC, mine, option]);
            }
            (true, None) => received.reply.extend([IAC, refusal, option]),
            (false, Some(place)) => {
                self.sent.swap_remove(place);
                received.reply.extend([IAC, refusal, option]);
            }
        }
    }

    fn supports(&self, option: u8) -> bool {
        SUPPORTED.contains(&option) && (option != COM_PORT || self.side != TelnetSide::PlainClient)
    }

    fn subnegotiated(&mut self, received: &mut TelnetReceived) {
        let inside = self.inside.take().unwrap_or_default();
        let [COM_PORT, code, value @ ..] = inside.as_slice() else { return };
        match (self.side, *code) {
            (TelnetSide::Client, code) if code == ANSWER + SUSPEND => self.suspended = true,
            (TelnetSide::Client, code) if code == ANSWER + RESUME => self.suspended = false,
            (TelnetSide::Client, SET_BAUD..=SET_CONTROL) => {}
            // Only answers to commands are stored: notifications of the state of the line never end.
            (TelnetSide::Client, code @ ANSWER..=200)
                if (SET_BAUD..=SET_CONTROL).contains(&(code - ANSWER)) =>
            {
                self.answers.push((code - ANSWER, value.to_vec()));
            }
            (TelnetSide::Server, code @ (SET_BAUD..=SET_CONTROL | 10..=12)) => {
                received.reply.extend(Self::command(code + ANSWER, value));
            }
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Lets both ends talk until neither answers.
    fn settled(client: &mut Telnet, server: &mut Telnet, mut to_server: Vec<u8>, mut to_client: Vec<u8>) {
        for _ in 0..10 {
            let (from_server, from_client) =
                (server.receive(&to_server).reply, client.receive(&to_client).reply);
            (to_server, to_client) = (from_client, from_server);
            if to_server.is_empty() && to_client.is_empty() {
                return;
            }
        }
        panic!("the negotiation does not end");
    }

    #[test]
    fn both_ends_negotiate_and_answer_a_command() {
        let (mut client, hello) = Telnet::new(TelnetSide::Client);
        let (mut server, welcome) = Telnet::new(TelnetSide::Server);
        settled(&mut client, &mut server, hello, welcome);
        assert_eq!((client.com_port(), server.com_port()), (Some(true), Some(true)));
        // 255 in a value is doubled: 65535 baud.
        let asked = Telnet::command(SET_BAUD, &65535u32.to_be_bytes());
        assert_eq!(asked, [255, 250, 44, 1, 0, 0, 255, 255, 255, 255, 255, 240]);
        let answered = server.receive(&asked).reply;
        client.receive(&answered);
        assert_eq!(client.answer(SET_BAUD), Some(65535u32.to_be_bytes().to_vec()));
        assert_eq!(client.answer(SET_BAUD), None);
    }

    #[test]
    fn server_without_the_option_is_detected() {
        let (mut client, _) = Telnet::new(TelnetSide::Client);
        let received = client.receive(&[IAC, DONT, COM_PORT, IAC, WILL, 1]);
        assert_eq!(client.com_port(), Some(false));
        // The agreement is taken back, and echo is refused.
        assert_eq!(received.reply, [IAC, WONT, COM_PORT, IAC, DONT, 1]);
    }

    /// The greeting of ser2net: it offers to suppress go-ahead and binary data, and asks for binary data.
    #[test]
    fn plain_telnet_agrees_on_bytes_and_refuses_the_rest() {
        let server = [IAC, WILL, 3, IAC, WILL, 0, IAC, DO, 0, IAC, DO, COM_PORT, IAC, WILL, 1, 7];
        assert!(Telnet::is_greeting(&server));
        for other in [&[][..], &[IAC, WILL], &[IAC, IAC, 3], &[1, IAC, WILL, 3], &[IAC, DO, 200]] {
            assert!(!Telnet::is_greeting(other), "{other:?}");
        }
        let (mut client, greeting) = Telnet::new(TelnetSide::PlainClient);
        assert_eq!(greeting, [IAC, WILL, 0, IAC, DO, 0, IAC, WILL, 3, IAC, DO, 3]);
        let received = client.receive(&server);
        assert_eq!(received.reply, [IAC, WONT, COM_PORT, IAC, DONT, 1]);
        assert_eq!(received.data, [7]);
    }

    proptest! {
        #[test]
        fn data_do_not_depend_on_splits(data: Vec<u8>, cut in 1usize..9) {
            let (mut client, _) = Telnet::new(TelnetSide::Client);
            let mut came = Vec::new();
            for part in Telnet::escaped(&data).chunks(cut) {
                came.extend(client.receive(part).data);
            }
            prop_assert_eq!(came, data);
        }
    }

    /// RFC 2217: an answer is the command plus 100.
    #[test]
    fn server_answers_with_the_command_plus_100() {
        let (mut server, _) = Telnet::new(TelnetSide::Server);
        for code in [SET_BAUD, SET_DATA_BITS, SET_PARITY, SET_STOP_BITS, SET_CONTROL, 10, 11, 12] {
            let reply = server.receive(&Telnet::command(code, &[8])).reply;
            assert_eq!(reply, [255, 250, 44, code + 100, 8, 255, 240]);
        }
        assert!(server.receive(&Telnet::command(6, &[8])).reply.is_empty());
    }

    #[test]
    fn latest_answer_counts() {
        let (mut client, _) = Telnet::new(TelnetSide::Client);
        for (code, value) in [(102, 7), (103, 1), (102, 8)] {
            client.receive(&Telnet::command(code, &[value]));
        }
        assert_eq!(client.answer(SET_DATA_BITS), Some(vec![8]));
        assert_eq!(client.answer(SET_DATA_BITS), None);
        assert_eq!(client.answer(SET_PARITY), Some(vec![1]));
        // A notification of the state of the line is none.
        client.receive(&Telnet::command(106, &[1]));
        assert_eq!(client.answer(6), None);
    }

    #[test]
    fn server_suspends_and_resumes_the_data() {
        let (mut client, _) = Telnet::new(TelnetSide::Client);
        client.receive(&Telnet::command(108, &[]));
        assert!(client.is_suspended());
        client.receive(&Telnet::command(109, &[]));
        assert!(!client.is_suspended());
    }

    #[test]
    fn commands_are_no_data() {
        let (mut client, _) = Telnet::new(TelnetSide::Client);
        // NOP and an escaped 255 between data.
        let received = client.receive(&[1, IAC, 241, 2, IAC, IAC, 3]);
        assert_eq!(received.data, [1, 2, IAC, 3]);
        assert!(received.reply.is_empty());
    }
}
