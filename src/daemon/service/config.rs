//! The configuration of the service. It is a TOML file; `docs/reference/service.md` explains its keys.

use std::collections::BTreeMap;
use std::fs;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::ops::Range;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use toml::Spanned;

use crate::daemon::ALARM_SHARE;
use crate::live::ServiceFinding::{
    self, NoPlans, NotADirectory, NotAHost, NotAProtocol, NotAProxy, NotAStroke, NotAUser, NotAnAddress,
    NotReadings, OneDirectory, OpenWithoutToken, OutOfRange, ParametersWithoutProtocol, TokenTooShort,
    TokenUnreadable,
};
use crate::live::{KnownUser, Role, Token};
use dbbd_device::clock;
use dbbd_device::port::PortAddress;
use dbbd_device::port::PortFinding;
use dbbd_device::protocol::ProtocolDefinition;
use dbbd_job::files;
use dbbd_model::base::fixed_array::FixedArray;
use dbbd_model::base::parse::from_toml;
use dbbd_model::base::text::is_control;
use dbbd_model::diagnostic::{Diagnostic, Finding};
use dbbd_model::provenance::Identity;

/// Default of [`ServiceConfig::gone_s`].
const GONE_S: f64 = 60.0;
/// Least alarm share: a smaller share raises the alarm permanently.
const MIN_ALARM_SHARE: f64 = 0.05;
/// Longest stroke of a bar, mm: larger numbers are micrometres.
const MAX_STROKE_MM: f64 = 500.0;
/// Default of [`ArchiveTarget::retry_s`].
#[cfg(feature = "archive")]
const RETRY_S: f64 = 60.0;
/// Longest name of a user, bytes.
const LONGEST_USER: usize = 64;
/// Longest time to wait for a port, s: larger numbers are milliseconds.
const MAX_GONE_S: f64 = 14_400.0;

/// The address of a service, its host names and its token.
#[derive(Debug)]
pub struct Endpoint {
    pub address: SocketAddr,
    /// Host names of the service besides its addresses.
    pub hosts: Vec<String>,
    pub token: Option<Token>,
    /// Named users beside the owner of the token.
    pub users: Vec<KnownUser>,
    /// Proxies that are trusted to name their clients.
    pub proxies: Vec<IpAddr>,
}

#[derive(Debug)]
pub struct ServiceConfig {
    pub endpoint: Endpoint,
    /// The directory of the runs.
    pub data: PathBuf,
    /// The directory of the plans: `NAME/plan.csv`.
    pub plans: PathBuf,
    pub port: Option<PortAddress>,
    /// Protocol of the bar; `None` for the protocol of the plan.
    pub protocol: Option<ProtocolDefinition>,
    /// A run ends when its port has been absent for this time.
    pub gone_s: f64,
    /// Share of the half stroke beyond which the alarm is raised.
    pub alarm_share: f64,
    /// The stroke without a plan, mm.
    pub stroke_mm: Option<[f64; 2]>,
    /// Identity data of every run.
    pub identity: Identity,
    pub archive: Option<ArchiveTarget>,
}

/// The archive that receives completed runs.
#[derive(Debug)]
pub struct ArchiveTarget {
    /// Database, as in `dbbd archive --archive`.
    pub database: String,
    /// Store, as in `dbbd archive --store`.
    pub store: String,
    /// Base of relative paths in database and store.
    pub base: PathBuf,
    /// Directory of the runs that wait while the archive is unreachable.
    pub spool: PathBuf,
    /// Interval between attempts while runs wait, s.
    pub retry_s: f64,
}

#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct ConfigFile {
    address: Option<Spanned<String>>,
    hosts: Vec<Spanned<String>>,
    token_file: Option<Spanned<String>>,
    trusted_proxies: Vec<Spanned<String>>,
    user: Vec<Spanned<UserTable>>,
    data: Option<String>,
    plans: Option<String>,
    device: DeviceTable,
    alarm: AlarmTable,
    identity: Option<Spanned<Identity>>,
    archive: Option<Spanned<ArchiveTable>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct UserTable {
    name: String,
    role: Role,
    /// SHA-256 of the token in hexadecimal digits.
    token_hash: String,
}

#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct DeviceTable {
    port: Option<Spanned<String>>,
    protocol: Option<Spanned<String>>,
    params: BTreeMap<String, String>,
    gone_s: Option<Spanned<f64>>,
}

#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct AlarmTable {
    share: Option<Spanned<f64>>,
    stroke_mm: Option<Spanned<FixedArray<f64, 2>>>,
}

#[cfg(not(feature = "archive"))]
type ArchiveTable = serde::de::IgnoredAny;

#[cfg(feature = "archive")]
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ArchiveTable {
    database: String,
    store: String,
    spool: Option<String>,
    retry_s: Option<Spanned<f64>>,
}

impl Default for ServiceConfig {
    fn default() -> Self {
        Self {
            endpoint: Endpoint {
                address: SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 8230),
                hosts: Vec::new(),
                token: None,
                users: Vec::new(),
                proxies: Vec::new(),
            },
            data: PathBuf::from("dbbd-runs"),
            plans: PathBuf::from("."),
            port: None,
            protocol: None,
            gone_s: GONE_S,
            alarm_share: ALARM_SHARE,
            stroke_mm: None,
            identity: Identity::default(),
            archive: None,
        }
    }
}

/// The file, for messages and relative paths.
struct ConfigSource<'a> {
    file: String,
    text: &'a str,
    base: &'a Path,
}

impl ConfigSource<'_> {
    fn wrong(&self, span: Range<usize>, finding: impl Finding) -> Diagnostic {
        Diagnostic::span(&self.file, self.text, span, finding)
    }

    fn number(&self, value: &Spanned<f64>, low: f64, high: f64) -> Result<f64, Diagnostic> {
        let number = *value.get_ref();
        if number.is_finite() && (low..=high).contains(&number) {
            return Ok(number);
        }
        Err(self.wrong(value.span(), OutOfRange { value: number, least: low, most: high }))
    }
}

impl Endpoint {
    /// An address that other computers can reach needs a token.
    pub fn new(address: &str, token_file: Option<&Path>, hosts: &[String]) -> Result<Self, ServiceFinding> {
        let mut endpoint = ServiceConfig::default().endpoint;
        endpoint.token = token_file.map(token).transpose()?;
        endpoint.listen(address)?;
        hosts.iter().try_for_each(|host| endpoint.add_host(host))?;
        Ok(endpoint)
    }

    /// Takes all users who are asked for a token, the owner included.
    pub(super) fn take_users(&mut self) -> Vec<KnownUser> {
        let owner = self.token.take().map(KnownUser::owner);
        owner.into_iter().chain(std::mem::take(&mut self.users)).collect()
    }

    /// Sets the address. The token and the users must be set before.
    fn listen(&mut self, address: &str) -> Result<(), ServiceFinding> {
        self.address = address.parse().map_err(|_| NotAnAddress)?;
        if !self.address.ip().is_loopback() && self.token.is_none() && self.users.is_empty() {
            return Err(OpenWithoutToken);
        }
        Ok(())
    }

    fn add_host(&mut self, host: &str) -> Result<(), ServiceFinding> {
        let sound = |c: char| c.is_ascii_alphanumeric() || "-.".contains(c);
        if host.is_empty() || !host.chars().all(sound) {
            return Err(NotAHost);
        }
        self.hosts.push(host.into());
        Ok(())
    }
}

impl ServiceConfig {
    /// Reads a file.
    pub fn read(path: &Path) -> Result<Self, Diagnostic> {
        Self::from_toml(path, &files::read_definition(path)?)
    }

    /// Reads the text of a configuration file. Relative paths in it start at the directory of the file.
    pub fn from_toml(path: &Path, text: &str) -> Result<Self, Diagnostic> {
        let file = path.display().to_string();
        let base = path.parent().unwrap_or(Path::new(""));
        let table: ConfigFile = from_toml(&file, text).map_err(|wrong| match wrong.help_line() {
            Some(_) => wrong,
            None => wrong.help("docs/reference/service.md explains every key"),
        })?;
        Self::from_table(&ConfigSource { file, text, base }, table)
    }

    fn from_table(source: &ConfigSource, table: ConfigFile) -> Result<Self, Diagnostic> {
        let mut config =
            Self { data: source.base.join("dbbd-runs"), plans: source.base.into(), ..Self::default() };
        config.data = table.data.map_or(config.data, |path| source.base.join(path));
        config.plans = table.plans.map_or(config.plans, |path| source.base.join(path));
        if config.plans.as_os_str().is_empty() {
            config.plans = PathBuf::from(".");
        }
        let is_file = |path: &Path| path.exists() && !path.is_dir();
        if let Some(path) = [&config.data, &config.plans].into_iter().find(|path| is_file(path)) {
            return Err(Diagnostic::file(path.display().to_string(), NotADirectory));
        }
        if files::same_place(&config.data, &config.plans) {
            return Err(Diagnostic::file(config.data.display().to_string(), OneDirectory));
        }
        if !config.plans.is_dir() {
            return Err(Diagnostic::file(config.plans.display().to_string(), NoPlans));
        }
        if let Some(path) = &table.token_file {
            let file = source.base.join(path.get_ref());
            config.endpoint.token = Some(token(&file).map_err(|wrong| source.wrong(path.span(), wrong))?);
        }
        let users = table.user.iter().map(Spanned::get_ref);
        let all: Vec<_> = users.map(|user| (user.name.clone(), user.token_hash.to_lowercase())).collect();
        for user in table.user {
            let span = user.span();
            config.endpoint.users.push(
                known_user(user.into_inner(), &all).map_err(|wrong| source.wrong(span.clone(), wrong))?,
            );
        }
        if let Some(address) = &table.address {
            let listen = config.endpoint.listen(address.get_ref());
            listen.map_err(|wrong| source.wrong(address.span(), wrong))?;
        }
        for host in table.hosts {
            config.endpoint.add_host(host.get_ref()).map_err(|wrong| source.wrong(host.span(), wrong))?;
        }
        for proxy in table.trusted_proxies {
            let address = proxy.get_ref().parse().map_err(|_| source.wrong(proxy.span(), NotAProxy))?;
            config.endpoint.proxies.push(address);
        }
        if let Some(port) = table.device.port {
            let address = port.get_ref().parse();
            config.port = Some(address.map_err(|finding: PortFinding| source.wrong(port.span(), finding))?);
        }
        if let Some(name) = &table.device.protocol {
            let params: Vec<_> = table.device.params.into_iter().collect();
            config.protocol = Some(definition(source, name, &params)?);
        } else if !table.device.params.is_empty() {
            return Err(Diagnostic::file(&source.file, ParametersWithoutProtocol));
        }
        if let Some(gone_s) = &table.device.gone_s {
            config.gone_s = source.number(gone_s, 0.0, MAX_GONE_S)?;
        }
        if let Some(share) = &table.alarm.share {
            config.alarm_share = source.number(share, MIN_ALARM_SHARE, 1.0)?;
        }
        if let Some(stroke) = table.alarm.stroke_mm {
            let checked = check_stroke(stroke.get_ref().0);
            checked.map_err(|wrong| source.wrong(stroke.span(), wrong))?;
            config.stroke_mm = Some(stroke.get_ref().0);
        }
        if let Some(identity) = table.identity {
            let checked = identity.get_ref().check_all();
            let checked = checked.and_then(|()| identity.get_ref().check_dates(clock::unix_ns()));
            checked.map_err(|(_, wrong)| wrong.at_span(&source.file, source.text, identity.span()))?;
            config.identity = identity.into_inner();
        }
        config.archive = table.archive.map(|table| to_archive(source, table)).transpose()?;
        Ok(config)
    }
}

fn check_stroke([low, high]: [f64; 2]) -> Result<(), ServiceFinding> {
    if !(low.is_finite() && high.is_finite() && low < high) {
        return Err(NotAStroke);
    }
    if let Some(value) = [low, high].into_iter().find(|end| end.abs() > MAX_STROKE_MM) {
        return Err(OutOfRange { value, least: -MAX_STROKE_MM, most: MAX_STROKE_MM });
    }
    // Readings are near zero. Numbers far from it are lengths.
    if low.max(-high) > high - low { Err(NotReadings { low, high }) } else { Ok(()) }
}

#[cfg(not(feature = "archive"))]
fn to_archive(source: &ConfigSource, table: Spanned<ArchiveTable>) -> Result<ArchiveTarget, Diagnostic> {
    Err(source.wrong(table.span(), dbbd_plant::ArchiveFinding::NotBuilt))
}

#[cfg(feature = "archive")]
fn to_archive(source: &ConfigSource, table: Spanned<ArchiveTable>) -> Result<ArchiveTarget, Diagnostic> {
    use dbbd_plant::{ArchiveAddresses, Secrets};
    let ArchiveTable { database, store, spool, retry_s } = table.into_inner();
    let addresses = ArchiveAddresses::read(Some(&database), Some(&store), &Secrets::of_environment())?;
    let spool = spool.unwrap_or_else(|| "dbbd-spool".into());
    addresses.check_spool(source.base, std::path::Path::new(&spool))?;
    Ok(ArchiveTarget {
        database,
        store,
        base: source.base.into(),
        spool: source.base.join(spool),
        retry_s: retry_s.map_or(Ok(RETRY_S), |retry_s| source.number(&retry_s, 0.01, 1e6))?,
    })
}

/// A built-in protocol or a protocol file.
fn definition(
    source: &ConfigSource,
    name: &Spanned<String>,
    params: &[(String, String)],
) -> Result<ProtocolDefinition, Diagnostic> {
    if let Some(built_in) = ProtocolDefinition::by_name_with(name.get_ref(), params) {
        return built_in;
    }
    let path = source.base.join(name.get_ref());
    let text = fs::read_to_string(&path).map_err(|error| {
        let finding = NotAProtocol { name: name.get_ref().clone(), why: error.to_string() };
        source.wrong(name.span(), finding)
    })?;
    ProtocolDefinition::from_toml_with(&path.display().to_string(), &text, params)
}

/// Checks a user of the file. `all` are the names of all users, and the hashes of their tokens.
fn known_user(user: UserTable, all: &[(String, String)]) -> Result<KnownUser, ServiceFinding> {
    let UserTable { name, role, token_hash } = user;
    if name.trim().is_empty() || name.len() > LONGEST_USER || name.contains(is_control) {
        return Err(NotAUser { why: "its name is empty, too long or not printable" });
    }
    if all.iter().filter(|(other, _)| *other == name).count() > 1 {
        return Err(NotAUser { why: "there is another one of this name" });
    }
    if all.iter().filter(|(_, other)| *other == token_hash.to_lowercase()).count() > 1 {
        return Err(NotAUser { why: "another one has this token" });
    }
    KnownUser::named(name, role, &token_hash)
        .ok_or(NotAUser { why: "token_hash has no 64 hexadecimal digits" })
}

fn token(file: &Path) -> Result<Token, ServiceFinding> {
    let text = fs::read_to_string(file).map_err(|error| TokenUnreadable { why: error.to_string() })?;
    if files::mode(file) & 0o007 != 0 {
        return Err(ServiceFinding::TokenOpen);
    }
    Token::new(&text).ok_or(TokenTooShort)
}
