//! Addresses of the database and the store, and their secrets.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use postgres::config::{Host, SslMode};

use crate::ArchiveFinding::{
    NoAddress, NoPath, NoRootCertificate, NotASecret, NotAnAddress, OtherScheme, OtherSslMode,
    SecretInAddress, SecretOpen, SecretUnreadable, SpoolInStore,
};
use dbbd_job::files;
use dbbd_model::diagnostic::Diagnostic;

/// The environment variables of [`Secrets`], in the order of its fields.
const VARIABLES: [&str; 3] = ["PGPASSWORD", "DBBD_ARCHIVE_PASSWORD_FILE", "DBBD_STORE_SECRET_FILE"];
const ARCHIVE: &str = "archive";
const STORE: &str = "store";

#[derive(Clone)]
pub(super) enum DatabaseAddress {
    Sqlite(PathBuf),
    /// PostgreSQL, with the certificate file of its authority if the connection is encrypted.
    Postgres(Box<postgres::Config>, Option<PathBuf>),
}

#[derive(Clone)]
pub(super) enum StoreAddress {
    Directory(PathBuf),
    S3 { bucket: String, prefix: String, keys: Option<[String; 2]> },
}

/// The addresses of an archive. They hold passwords, so there is no `Debug`.
#[derive(Clone)]
pub struct ArchiveAddresses {
    pub(super) archive: DatabaseAddress,
    pub(super) store: StoreAddress,
}

/// Secrets from the environment. They are never on the command line.
#[derive(Default)]
pub struct Secrets {
    pub password: Option<String>,
    password_file: Option<PathBuf>,
    /// A file with two lines: key identity and secret key.
    pub store_file: Option<PathBuf>,
}

impl Secrets {
    /// The environment variables that a child process needs to reach an archive.
    pub fn variables() -> impl Iterator<Item = (OsString, OsString)> {
        std::env::vars_os().filter(|(name, _)| {
            let name = name.to_string_lossy();
            name.starts_with("AWS_") || VARIABLES.contains(&&*name)
        })
    }

    pub fn of_environment() -> Self {
        let [password, password_file, store_file] = VARIABLES.map(std::env::var_os);
        Self {
            password: password.and_then(|password| password.into_string().ok()),
            password_file: password_file.map(PathBuf::from),
            store_file: store_file.map(PathBuf::from),
        }
    }
}

impl ArchiveAddresses {
    /// Parses the addresses. A secret that others can read is an error.
    pub fn read(archive: Option<&str>, store: Option<&str>, secrets: &Secrets) -> Result<Self, Diagnostic> {
        let missing =
            |option: &str, variable: &str| NoAddress { option: option.into(), variable: variable.into() };
        let archive = archive.ok_or_else(|| missing(ARCHIVE, "DBBD_ARCHIVE"))?;
        let store = store.ok_or_else(|| missing(STORE, "DBBD_STORE"))?;
        Ok(Self { archive: database(archive, secrets)?, store: objects(store, secrets)? })
    }

    /// Checks that the spool is not in the store. Relative paths start at `base`.
    pub fn check_spool(&self, base: &Path, spool: &Path) -> Result<(), Diagnostic> {
        let StoreAddress::Directory(store) = &self.store else { return Ok(()) };
        let place = |path: &Path| {
            let path = base.join(path);
            path.canonicalize().or_else(|_| std::path::absolute(&path)).unwrap_or(path)
        };
        if place(spool).starts_with(place(store)) { Err(SpoolInStore.into()) } else { Ok(()) }
    }
}

fn database(text: &str, secrets: &Secrets) -> Result<DatabaseAddress, Diagnostic> {
    if let Some(path) = text.strip_prefix("sqlite:") {
        // SQLite would open a temporary database.
        if ["", ":memory:"].contains(&path) {
            return Err(NoPath { option: ARCHIVE.into() }.into());
        }
        return Ok(DatabaseAddress::Sqlite(path.into()));
    }
    if !text.starts_with("postgres://") && !text.starts_with("postgresql://") {
        let schemes = "sqlite:FILE, postgres://USER@HOST/DATABASE".into();
        return Err(OtherScheme { option: ARCHIVE.into(), schemes }.into());
    }
    let (address, query) = text.split_once('?').unwrap_or((text, ""));
    let (mut mode, mut root, mut rest) = (None, None, Vec::new());
    for pair in query.split('&').filter(|pair| !pair.is_empty()) {
        match pair.split_once('=') {
            Some(("sslmode", value)) => mode = Some(value.to_owned()),
            Some(("sslrootcert", value)) => root = Some(PathBuf::from(value)),
            _ => rest.push(pair),
        }
    }
    let address = format!("{address}?{}", rest.join("&"));
    let parsed = postgres::Config::from_str(address.trim_end_matches('?'));
    let mut config =
        parsed.map_err(|error| NotAnAddress { option: ARCHIVE.into(), why: error.to_string() })?;
    if config.get_password().is_some() {
        return Err(SecretInAddress { option: ARCHIVE.into() }.into());
    }
    let is_here = config.get_hosts().iter().all(|host| match host {
        Host::Tcp(name) => ["localhost", "127.0.0.1", "::1"].contains(&name.as_str()),
        #[cfg(unix)]
        Host::Unix(_) => true,
    });
    let encrypted = match mode.as_deref() {
        Some("verify-full") => true,
        Some("disable") => false,
        None => !is_here,
        Some(other) => return Err(OtherSslMode { mode: other.into() }.into()),
    };
    if encrypted && root.is_none() {
        return Err(NoRootCertificate.into());
    }
    config.ssl_mode(if encrypted { SslMode::Require } else { SslMode::Disable });
    config.application_name("dbbd").connect_timeout(std::time::Duration::from_secs(10));
    config.tcp_user_timeout(std::time::Duration::from_secs(60));
    match (&secrets.password_file, &secrets.password) {
        (Some(path), _) => {
            config.password(secret(path)?.trim_end_matches(['\r', '\n']));
        }
        (None, Some(password)) => {
            config.password(password);
        }
        (None, None) => {}
    }
    Ok(DatabaseAddress::Postgres(Box::new(config), root.filter(|_| encrypted)))
}

fn objects(text: &str, secrets: &Secrets) -> Result<StoreAddress, Diagnostic> {
    if let Some(path) = text.strip_prefix("file:") {
        let path = path.trim_start_matches("//");
        if path.is_empty() {
            return Err(NoPath { option: STORE.into() }.into());
        }
        return Ok(StoreAddress::Directory(path.into()));
    }
    let Some(rest) = text.strip_prefix("s3://") else {
        let schemes = "file:DIRECTORY, s3://BUCKET/PREFIX".into();
        return Err(OtherScheme { option: STORE.into(), schemes }.into());
    };
    if rest.contains('@') || rest.contains('?') {
        return Err(SecretInAddress { option: STORE.into() }.into());
    }
    let (bucket, prefix) = rest.split_once('/').unwrap_or((rest, ""));
    if bucket.is_empty() {
        return Err(NotAnAddress { option: STORE.into(), why: "the bucket is missing".into() }.into());
    }
    let keys = secrets.store_file.as_deref().map(keys).transpose()?;
    Ok(StoreAddress::S3 { bucket: bucket.into(), prefix: prefix.trim_matches('/').into(), keys })
}

fn keys(path: &Path) -> Result<[String; 2], Diagnostic> {
    let text = secret(path)?;
    match text.lines().map(str::trim).filter(|line| !line.is_empty()).collect::<Vec<_>>()[..] {
        [id, key] => Ok([id.into(), key.into()]),
        _ => Err(NotASecret {
            variable: "DBBD_STORE_SECRET_FILE".into(),
            form: "two lines: the identity of the key and the secret key".into(),
        }
        .into()),
    }
}

/// The content of a file. Others must not be able to read it.
fn secret(path: &Path) -> Result<String, Diagnostic> {
    let name = path.display().to_string();
    let text = std::fs::read_to_string(path)
        .map_err(|error| Diagnostic::file(&name, SecretUnreadable { why: error.to_string() }))?;
    if files::mode(path) & 0o077 != 0 {
        return Err(Diagnostic::file(&name, SecretOpen));
    }
    Ok(text)
}
