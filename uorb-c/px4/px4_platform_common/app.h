/**
 * @file px4_platform_common/app.h
 *
 * Stands for PX4's header of this name: whether a task runs, and whether it
 * should.
 */

#ifndef UORB_PX4_APP_H
#define UORB_PX4_APP_H

#ifdef __cplusplus

#include <atomic>

namespace px4
{

/** Shared by the task and by who asks it to end. */
class AppState
{
public:
	AppState() = default;
	AppState(const AppState &) = delete;
	AppState &operator=(const AppState &) = delete;

	bool exitRequested() const { return _exit_requested; }
	void requestExit() { _exit_requested = true; }

	bool isRunning() const { return _is_running; }
	void setRunning(bool running) { _is_running = running; }

private:
	std::atomic<bool> _exit_requested{false};
	std::atomic<bool> _is_running{false};
};

} // namespace px4

/* The task of the example `hello`, whose name PX4's build gives. */
# ifdef PX4_MAIN
extern int PX4_MAIN(int argc, char *argv[]);
# endif

#endif

#endif /* UORB_PX4_APP_H */
