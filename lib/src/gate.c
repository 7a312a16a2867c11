/* A gate before the learner, as before a Kalman filter: innovations over what they usually are, one by
 * one to validate a sample, in the mean to see whether the model is still consistent (Bar-Shalom, Li and
 * Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001, section 5.4). What is usual
 * is learned here, and a model that is wrong is given up. */

#include <string.h>

#define GATE_MULTIPLE 5
#define GATE_MEMORY 5000 /* samples in the mean squares */
#define GATE_LEARNED 4   /* regressors times this: samples that a model is learned from */
#define GATE_MOST_STRAIN 3
#define GATE_MOST_PATIENCE ((size_t)-1 / 2)

static COLD int gate_config_check(const KOOP(gate_config) *c) {
	if (!c) { return KOOP_OK; }
	/* written so that NaN fails */
	if (!(c->multiple >= 0 && is_finite(c->multiple * c->multiple))) { return KOOP_E_RANGE; }
	if (c->multiple > 0 && c->multiple < 1) { return KOOP_E_RANGE; }
	if (!(c->floor >= 0 && is_finite(c->floor * c->floor))) { return KOOP_E_RANGE; }
	return c->patience <= GATE_MOST_PATIENCE ? KOOP_OK : KOOP_E_RANGE;
}

static size_t gate_theta_reals(const KOOP(rls) *rls) {
	return rls->n_regressors * rls->n_lifted_padded;
}

/* Twice as many samples as make a model are taken on trial; the second half shows how good it is. */
static void gate_begin_trial(KOOP(gate) *gate) {
	gate->refused = gate->sound = 0;
	gate->trial = 2 * gate->config.patience;
	gate->strain = 1;
}

static COLD void gate_configure(KOOP(gate) *gate, const KOOP(gate_config) *c) {
	if (c) { gate->config = *c; }
	if (!(gate->config.multiple > 0)) { gate->config.multiple = GATE_MULTIPLE; }
	if (gate->config.patience == 0) { gate->config.patience = GATE_LEARNED * gate->n_regressors; }
}

COLD int KOOP(gate_init)(KOOP(gate) *gate, const KOOP(gate_config) *config, const KOOP(rls) *rls,
                         real *storage, size_t reals) {
	if (!gate || !rls || !rls->theta || !storage) { return KOOP_E_NULL; }
	const int status = gate_config_check(config);
	if (status != KOOP_OK) { return status; }
	if (reals < KOOP_GATE_REALS(rls->n_lifted, rls->config.n_inputs)) { return KOOP_E_STORAGE; }

	(void)memset(gate, 0, sizeof *gate);
	gate->n_lifted = rls->n_lifted;
	gate->n_regressors = rls->n_regressors;
	gate_configure(gate, config);
	gate->last_good = storage;
	gate->usual = storage + gate_theta_reals(rls);
	copy(gate->last_good, rls->theta, gate_theta_reals(rls));
	for (size_t i = 0; i < rls->n_lifted; i++) { gate->usual[i] = 0; }
	gate_begin_trial(gate);
	return KOOP_OK;
}

static real gate_usual(const KOOP(gate) *gate, size_t i) {
	return max_of(gate->usual[i], gate->config.floor * gate->config.floor);
}

/* More is usual than was thought: twice as much, if that is seen. The last term grows from nothing. */
static COLD void gate_widen(KOOP(gate) *gate, const real *error) {
	for (size_t i = 0; i < gate->n_lifted; i++) {
		const real seen = error[i] * error[i], most = 4 * gate_usual(gate, i);
		if (!is_finite(seen)) { continue; }
		gate->usual[i] = max_of(gate->usual[i], max_of(seen < most ? seen : most, REAL_EPSILON * seen));
	}
	gate->known = gate->known < gate->config.patience ? gate->known : gate->config.patience; /* a guess */
}

/* From the last good model, by whatever samples come. */
static COLD void gate_restart(KOOP(gate) *gate, KOOP(rls) *rls) {
	if (gate->vain) { gate_widen(gate, rls->error); }
	gate->vain = 1; /* until a model has been good for a while */
	(void)KOOP(rls_copy_theta)(rls, gate->last_good);
	(void)KOOP(rls_reset_covariance)(rls, rls->config.p0);
	gate_begin_trial(gate);
	gate->restarts++;
}

/* Whether no innovation is an outlier, or all are taken. */
static int gate_admits(const KOOP(gate) *gate, const real *error) {
	if (gate->trial > 0) { return 1; }
	const real most = gate->config.multiple * gate->config.multiple;
	for (size_t i = 0; i < gate->n_lifted; i++) {
		if (!(error[i] * error[i] <= most * gate_usual(gate, i))) { return 0; }
	}
	return 1;
}

/* The mean squares with one more sample: plain means at first, then those of GATE_MEMORY samples. */
static void gate_learn_usual(KOOP(gate) *gate, const real *error) {
	gate->known += gate->known < GATE_MEMORY;
	for (size_t i = 0; i < gate->n_lifted; i++) {
		gate->usual[i] += (error[i] * error[i] - gate->usual[i]) / (real)gate->known;
	}
}

/* The mean of what is usual for each innovation, 1 for a model that is as good as ever. */
static void gate_judge(KOOP(gate) *gate, const real *error) {
	const real most = gate->config.multiple * gate->config.multiple;
	real sum = 0;
	for (size_t i = 0; i < gate->n_lifted; i++) {
		sum += error[i] * error[i] / (gate_usual(gate, i) + REAL_MIN);
	}
	const real mean = sum / (real)gate->n_lifted;
	const real seen = mean < most ? mean : most; /* NaN and Inf too */
	const size_t samples = gate->config.patience / 2 + 1;
	gate->strain += (seen - gate->strain) / (real)samples;
}

static void gate_count_sound(KOOP(gate) *gate, const KOOP(rls) *rls) {
	gate->refused -= gate->refused > 0;
	if (++gate->sound == gate->config.patience) {
		copy(gate->last_good, rls->theta, gate_theta_reals(rls));
		gate->sound = 0;
		gate->vain = 0;
	}
}

/* A sample of a trial. The first half only learns; the first trial has nothing to be judged by. */
static void gate_count_trial(KOOP(gate) *gate, const KOOP(rls) *rls) {
	gate->trial--;
	if (gate->trial >= gate->config.patience) { return; }
	if (gate->restarts == 0) {
		gate_learn_usual(gate, rls->error);
	} else {
		gate_judge(gate, rls->error);
	}
}

static void gate_count_taken(KOOP(gate) *gate, KOOP(rls) *rls) {
	if (gate->trial > 0) {
		gate_count_trial(gate, rls);
		if (gate->trial > 0) { return; }
	} else {
		gate_judge(gate, rls->error);
		gate_learn_usual(gate, rls->error);
	}
	if (gate->strain > GATE_MOST_STRAIN) {
		gate_restart(gate, rls);
	} else {
		gate_count_sound(gate, rls);
	}
}

static void gate_count_refused(KOOP(gate) *gate, KOOP(rls) *rls) {
	gate->sound = 0;
	if (gate->trial > 0) {
		gate->trial--;
	} else if (++gate->refused >= gate->config.patience) {
		gate_restart(gate, rls);
	}
}

static int gate_check(const KOOP(gate) *g, const KOOP(rls) *rls) {
	if (!g || !g->last_good || !rls || !rls->theta) { return KOOP_E_NULL; }
	return rls->n_lifted == g->n_lifted && rls->n_regressors == g->n_regressors ? KOOP_OK : KOOP_E_SIZE;
}

int KOOP(gate_update)(KOOP(gate) *gate, KOOP(rls) *rls, const real *psi, const real *u, const real *psi_next,
                      KOOP(health) *health) {
	KOOP(health) seen = {0, 0, 0, 0, 1, 1};
	int status = gate_check(gate, rls);
	if (status != KOOP_OK) { return status; }
	if (!psi || !u || !psi_next) { return KOOP_E_NULL; }

	status = innovate(rls, psi, u, psi_next, &seen.innovation);
	if (status == KOOP_OK && !gate_admits(gate, rls->error)) { status = KOOP_E_OUTLIER; }
	if (status == KOOP_OK) { status = learn(rls, &seen); }
	report(rls, status, &seen, health);
	if (status == KOOP_OK) {
		gate_count_taken(gate, rls);
	} else if (status != KOOP_E_INPUT) { /* a sensor that is not there says nothing of the model */
		gate_count_refused(gate, rls);
	}
	return status;
}
