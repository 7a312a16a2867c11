// Learns a model of a differential-drive robot, then drives it along a line with that model.
// The robot is simulated here, so that the sketch runs on a bare board: put your odometry and your
// motors into measure() and drive().
#include <tinykoop.h>

const int N = 7, STATES = 3, INPUTS = 2, HORIZON = 20; // of the dictionary koopf_poly_ddr

static float rls_storage[KOOP_RLS_REALS_SQRT(N, INPUTS)];
static float mpc_storage[KOOP_MPC_REALS_NEWTON(N, STATES, INPUTS, HORIZON)];
static koopf_rls rls;
static koopf_mpc mpc;
static float robot[STATES]; // px (m), py (m), theta (rad)

static void measure(float x[STATES]) {
	for (int i = 0; i < STATES; i++) { x[i] = robot[i]; }
}

static void drive(const float u[INPUTS]) { // speed (m/s), turn rate (rad/s), for 50 ms
	robot[0] += 0.05f * u[0] * cosf(robot[2]);
	robot[1] += 0.05f * u[0] * sinf(robot[2]);
	robot[2] += 0.05f * u[1];
}

static void start() {
	static const float Q[] = {20, 0, 0, 0, 20, 0, 0, 0, 3}, R[] = {0.05f, 0, 0, 0.08f};
	static const float low[] = {0, -1.2f}, high[] = {3.5f, 1.2f}, stop[] = {0, 0};
	koopf_config learning = {};
	learning.dictionary = &koopf_poly_ddr;
	learning.n_inputs = INPUTS;
	learning.regulator = &koopf_reg_sift;
	learning.form = &koopf_form_sqrt;
	learning.lambda = 0.98f;
	learning.p0 = 100;
	koopf_mpc_config control = {};
	control.n_lifted = N;
	control.n_states = STATES;
	control.n_inputs = INPUTS;
	control.horizon = HORIZON;
	control.Q = Q;
	control.R = R;
	control.u_min = low;
	control.u_max = high;
	control.u_safe = stop;
	int status = koopf_rls_init(&rls, &learning, rls_storage, sizeof rls_storage / sizeof *rls_storage);
	if (status == KOOP_OK) {
		status = koopf_mpc_init(&mpc, &control, mpc_storage, sizeof mpc_storage / sizeof *mpc_storage);
	}
	Serial.println(koopf_status_message(status));
}

// Excites the robot while it is being learned, then keeps it on the x axis at 1 m/s.
static void choose(unsigned long k, const float x[STATES], const float psi[N], float u[INPUTS]) {
	if (k < 200) {
		u[0] = 1 + 0.5f * sinf(0.1f * k);
		u[1] = 0.9f * cosf(0.23f * k);
		return;
	}
	float path[HORIZON * STATES];
	for (int i = 0; i < HORIZON; i++) {
		path[STATES * i] = x[0] + 0.05f * (i + 1);
		path[STATES * i + 1] = 0;
		path[STATES * i + 2] = 0;
	}
	koopf_mpc_solve(&mpc, rls.theta, psi, path, NULL, u, NULL); // without a plan, u is the stop
}

void setup() {
	Serial.begin(115200);
	start();
}

void loop() {
	static unsigned long k;
	static float psi[N], psi_next[N], u[INPUTS];
	static bool have_last; // never learn across a sample that was missed
	float x[STATES];
	koopf_health health = {};
	measure(x);
	const bool lifted = koopf_lift(&koopf_poly_ddr, x, psi_next) == KOOP_OK;
	if (lifted && have_last) { koopf_rls_update(&rls, psi, u, psi_next, &health); }
	for (int i = 0; i < N; i++) { psi[i] = psi_next[i]; }
	have_last = lifted;
	choose(k++, x, psi, u);
	drive(u);
	Serial.print("px ");
	Serial.print(x[0]);
	Serial.print(" py ");
	Serial.print(x[1]);
	Serial.print(" innovation ");
	Serial.println(health.innovation, 6);
	delay(50);
}
