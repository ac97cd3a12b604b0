//! Where a run was, without naming anybody's machine.

use std::fs;

use nix::sys::utsname::uname;

use crate::place::Cores;

pub fn describe(cores: Cores) -> String {
    let read = |path: &str| {
        fs::read_to_string(path).map_or("not told".into(), |text| text.trim().to_string())
    };
    let info = read("/proc/cpuinfo");
    let model = info.lines().find(|line| line.starts_with("model name"));
    let model = model.and_then(|line| line.split(": ").nth(1)).unwrap_or("not told");
    let kernel = uname().map_or("not told".into(), |it| {
        let release = it.release().to_string_lossy().into_owned();
        // 6.12.0-15-cloud: the number is enough.
        release.split('-').next().unwrap_or_default().to_string()
    });
    let virtual_machine =
        if info.contains(" hypervisor") { "virtual machine" } else { "no hypervisor seen" };
    let load = read("/proc/loadavg");
    let load = load.split(' ').next().unwrap_or_default();
    format!(
        "CPU           {model}, {} cores, {virtual_machine}\n\
         kernel        {kernel}\n\
         clock source  {}\n\
         governor      {}\n\
         load          {load}, when it began\n",
        cores.count(),
        read("/sys/devices/system/clocksource/clocksource0/current_clocksource"),
        read("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor"),
    )
}
