//! Rights that a thread of a bridge gives up once its sockets are open: capabilities, files, and system
//! calls.
//!
//! Reasons are in ADR 61.

use std::collections::BTreeMap;
use std::io;
use std::path::PathBuf;

use landlock::{
    ABI, Access, AccessFs, AccessNet, BitFlags, CompatLevel, Compatible, PathBeneath, PathFd, Ruleset,
    RulesetAttr, RulesetCreatedAttr, RulesetStatus, Scope, make_bitflags,
};
use seccompiler::{
    BpfProgram, SeccompAction, SeccompCmpArgLen, SeccompCmpOp, SeccompCondition, SeccompFilter, SeccompRule,
    TargetArch, apply_filter,
};

use crate::privileges::drop_capabilities;

/// The newest version of landlock whose rights are used; older kernels enforce the rights that they support.
const LANDLOCK: ABI = ABI::V6;

/// The task of a thread, which decides the rights that it keeps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ThreadRole {
    /// Opens and serves ports of the bus.
    Bus,
    /// The cycle of the hardware, on sockets that are open.
    Session {
        /// Whether it opens UDP sockets itself, at the beginning of each session.
        opens_udp: bool,
    },
    /// Writes to files that are open.
    Writer,
}

/// Gives up all rights of a bridge's thread except writing to open files. Returns the rights that this kernel
/// cannot remove.
///
/// # Errors
/// Capabilities cannot be dropped.
pub fn confine_writer() -> io::Result<Vec<String>> {
    confine(ThreadRole::Writer, &[])
}

/// Gives up every capability of the calling thread, every file outside of `folders`, and every system call
/// that its role does not need. Returns the rights that this kernel cannot remove.
///
/// # Errors
/// Capabilities cannot be dropped.
pub(crate) fn confine(role: ThreadRole, folders: &[PathBuf]) -> io::Result<Vec<String>> {
    drop_capabilities()?;
    let mut gaps = Vec::new();
    match restrict_files(role, folders) {
        Ok(RulesetStatus::FullyEnforced | RulesetStatus::PartiallyEnforced) => {}
        Ok(RulesetStatus::NotEnforced) => gaps.push(
            "files are not confined: this kernel has no landlock, or was started without it \
             (lsm=landlock,...)"
                .to_owned(),
        ),
        Err(error) => gaps.push(format!("files are not confined: {error}")),
    }
    if let Err(error) = filter(role).and_then(|filter| apply_filter(&filter)) {
        gaps.push(format!("system calls are not filtered: {error}"));
    }
    Ok(gaps)
}

fn restrict_files(
    role: ThreadRole,
    folders: &[PathBuf],
) -> Result<RulesetStatus, Box<dyn core::error::Error>> {
    let allowed: BitFlags<AccessFs> = make_bitflags!(AccessFs::{
        ReadFile | ReadDir | WriteFile | Truncate | MakeDir | MakeReg | MakeSock | RemoveDir | RemoveFile | Refer
    });
    let mut scope = BitFlags::from(Scope::AbstractUnixSocket);
    if role != ThreadRole::Bus {
        // The bus checks with signal 0 whether processes are alive; a blocked signal would look like a dead
        // process.
        scope |= Scope::Signal;
    }
    let mut rules = Ruleset::default()
        .set_compatibility(CompatLevel::BestEffort)
        .handle_access(AccessFs::from_all(LANDLOCK))?
        .handle_access(AccessNet::from_all(LANDLOCK))?
        .scope(scope)?
        .create()?;
    if role == ThreadRole::Bus {
        for folder in folders {
            rules = rules.add_rule(PathBeneath::new(PathFd::new(folder)?, allowed))?;
        }
    }
    Ok(rules.restrict_self()?.ruleset)
}

/// System calls of every role: memory, locks, time, open descriptors, and the end of the thread.
const COMMON: &[i64] = &[
    libc::SYS_brk,
    libc::SYS_clock_gettime,
    libc::SYS_clock_nanosleep,
    libc::SYS_close,
    libc::SYS_exit,
    libc::SYS_exit_group,
    libc::SYS_futex,
    libc::SYS_getpid,
    libc::SYS_getrandom,
    libc::SYS_gettid,
    libc::SYS_lseek,
    libc::SYS_madvise,
    libc::SYS_mremap,
    libc::SYS_munmap,
    libc::SYS_nanosleep,
    libc::SYS_ppoll,
    libc::SYS_read,
    libc::SYS_restart_syscall,
    libc::SYS_rt_sigaction,
    libc::SYS_rt_sigprocmask,
    libc::SYS_rt_sigreturn,
    libc::SYS_sched_yield,
    libc::SYS_sigaltstack,
    // A panic that cannot be caught ends the process by it.
    libc::SYS_tgkill,
    libc::SYS_write,
    libc::SYS_writev,
    #[cfg(target_arch = "x86_64")]
    libc::SYS_poll,
];

/// System calls of open sockets.
const SOCKETS: &[i64] = &[
    libc::SYS_recvfrom,
    libc::SYS_recvmsg,
    libc::SYS_sendmsg,
    libc::SYS_sendto,
];

/// System calls to open sockets.
const NEW_SOCKETS: &[i64] = &[
    libc::SYS_bind,
    libc::SYS_connect,
    libc::SYS_getpeername,
    libc::SYS_getsockname,
    libc::SYS_getsockopt,
    libc::SYS_setsockopt,
];

/// System calls of ports of the bus: files of one folder, shared memory, file locks.
const BUS: &[i64] = &[
    libc::SYS_dup,
    libc::SYS_faccessat,
    libc::SYS_faccessat2,
    libc::SYS_fallocate,
    libc::SYS_fchmod,
    libc::SYS_fchmodat,
    libc::SYS_fcntl,
    libc::SYS_flock,
    libc::SYS_fstat,
    libc::SYS_fstatfs,
    libc::SYS_fsync,
    libc::SYS_ftruncate,
    libc::SYS_getdents64,
    libc::SYS_getegid,
    libc::SYS_geteuid,
    libc::SYS_getgid,
    libc::SYS_getppid,
    libc::SYS_getuid,
    libc::SYS_mkdirat,
    libc::SYS_mlock,
    libc::SYS_munlock,
    libc::SYS_newfstatat,
    libc::SYS_openat,
    libc::SYS_pread64,
    libc::SYS_prlimit64,
    libc::SYS_pwrite64,
    libc::SYS_readlinkat,
    libc::SYS_renameat,
    libc::SYS_renameat2,
    libc::SYS_sched_getaffinity,
    libc::SYS_sched_getparam,
    libc::SYS_sched_getscheduler,
    libc::SYS_statfs,
    libc::SYS_statx,
    libc::SYS_sysinfo,
    libc::SYS_umask,
    libc::SYS_uname,
    libc::SYS_unlinkat,
    libc::SYS_utimensat,
    #[cfg(target_arch = "x86_64")]
    libc::SYS_access,
    #[cfg(target_arch = "x86_64")]
    libc::SYS_chmod,
    #[cfg(target_arch = "x86_64")]
    libc::SYS_getdents,
    #[cfg(target_arch = "x86_64")]
    libc::SYS_lstat,
    #[cfg(target_arch = "x86_64")]
    libc::SYS_mkdir,
    #[cfg(target_arch = "x86_64")]
    libc::SYS_open,
    #[cfg(target_arch = "x86_64")]
    libc::SYS_readlink,
    #[cfg(target_arch = "x86_64")]
    libc::SYS_rename,
    #[cfg(target_arch = "x86_64")]
    libc::SYS_rmdir,
    #[cfg(target_arch = "x86_64")]
    libc::SYS_stat,
    #[cfg(target_arch = "x86_64")]
    libc::SYS_unlink,
];

/// A condition: an argument has a value in the bits of a mask.
fn argument(number: u8, mask: u32, value: u32) -> Result<SeccompCondition, seccompiler::Error> {
    let condition = SeccompCondition::new(
        number,
        SeccompCmpArgLen::Dword,
        SeccompCmpOp::MaskedEq(u64::from(mask)),
        u64::from(value),
    );
    Ok(condition?)
}

/// A filter that permits the calls of a role and returns EPERM for all others.
fn filter(role: ThreadRole) -> Result<BpfProgram, seccompiler::Error> {
    // Mask of a socket's type, without its flags.
    const KIND: u32 = 0xF;
    let mut rules: BTreeMap<i64, Vec<SeccompRule>> = BTreeMap::new();
    let mut free = |calls: &[i64]| rules.extend(calls.iter().map(|call| (*call, Vec::new())));
    free(COMMON);
    match role {
        ThreadRole::Bus => {
            free(SOCKETS);
            free(NEW_SOCKETS);
            free(BUS);
        }
        ThreadRole::Session { opens_udp } => {
            free(SOCKETS);
            if opens_udp {
                free(NEW_SOCKETS);
            }
        }
        ThreadRole::Writer => free(&[libc::SYS_fsync, libc::SYS_ftruncate]),
    }
    // No new executable memory.
    for call in [libc::SYS_mmap, libc::SYS_mprotect] {
        let no_code = SeccompRule::new(vec![argument(2, libc::PROT_EXEC as u32, 0)?])?;
        rules.insert(call, vec![no_code]);
    }
    let socket = |family: i32, kind: i32| {
        let conditions = vec![
            argument(0, u32::MAX, family as u32)?,
            argument(1, KIND, kind as u32)?,
        ];
        Ok::<_, seccompiler::Error>(SeccompRule::new(conditions)?)
    };
    match role {
        ThreadRole::Bus => {
            let ours = vec![
                socket(libc::AF_UNIX, libc::SOCK_DGRAM)?,
                socket(libc::AF_UNIX, libc::SOCK_STREAM)?,
            ];
            rules.insert(libc::SYS_socket, ours);
            // Signal 0, to check whether a process is alive.
            rules.insert(
                libc::SYS_kill,
                vec![SeccompRule::new(vec![argument(1, u32::MAX, 0)?])?],
            );
        }
        ThreadRole::Session { opens_udp: true } => {
            let udp = vec![
                socket(libc::AF_INET, libc::SOCK_DGRAM)?,
                socket(libc::AF_INET6, libc::SOCK_DGRAM)?,
            ];
            rules.insert(libc::SYS_socket, udp);
            let nonblocking = SeccompRule::new(vec![argument(1, u32::MAX, libc::FIONBIO as u32)?])?;
            rules.insert(libc::SYS_ioctl, vec![nonblocking]);
        }
        ThreadRole::Session { opens_udp: false } | ThreadRole::Writer => {}
    }
    let filter = SeccompFilter::new(
        rules,
        SeccompAction::Errno(libc::EPERM as u32),
        SeccompAction::Allow,
        TargetArch::try_from(std::env::consts::ARCH)?,
    )?;
    Ok(filter.try_into()?)
}
